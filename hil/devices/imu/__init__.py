"""Inertial units: rates, gravity and attitude."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hil.core.device import DeviceKind, Topic
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import ImuSample, Status
from hil.devices.doctor_watch import Watched
from hil.devices.imu.bno055_model import Bno055
from hil.devices.imu.doctor_check import look
from hil.devices.imu.microstrain import MicroStrain

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "imu_message"]

_UNKNOWN = (0.0,) * 9
"""A covariance, as `sensor_msgs/Imu` has it where nothing is known of it."""


def imu_message(sample: ImuSample, ros: MessageMaker) -> bytes:
    """`sensor_msgs/Imu` as CDR; acceleration with gravity (specific force), as REP 145 asks."""
    w, x, y, z = sample.quaternion_wxyz.tolist()
    rates, force = sample.gyro_rad_s.tolist(), sample.specific_force_m_s2.tolist()
    values = (x, y, z, w, *_UNKNOWN, *rates, *_UNKNOWN, *force, *_UNKNOWN)
    return ros.numbers(sample.stamp.t_ns, ("imu",), values)


class Imu(DeviceKind):
    """Rates, specific force and attitude."""

    name, noun, sample = "imu", "IMU", ImuSample
    models = (Bno055(), MicroStrain())
    max_age_s, max_gap_s, min_delivered = 0.02, 0.1, 0.95
    topics = (Topic("/imu/data", "sensor_msgs/msg/Imu", imu_message),)
    motion_threshold = 0.2  # m/s^2: gravity turns with the robot, 0.17 for a degree
    silent_faults: ClassVar[Mapping[str, str]] = {
        "jump": "its own heading is not used: gyro and gravity are",
        "slow": "nothing notices: values of a moment ago come as often as new ones would",
        "delayed": "nothing notices on a straight way: values of 0.1 s ago carry fresh stamps",
    }

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.imu_stale_s`."""
        return float(safety.imu_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """That of its table, else the loop rate up to 100 Hz."""
        return float(getattr(config, "rate_hz", min(loop_hz, 100.0)))

    def motion_value(self, sample: ImuSample) -> Array | None:
        """Gravity (3,) in m/s^2."""
        return sample.gravity_m_s2 if sample.status is Status.OK else None

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Samples, calibration, gravity."""
        return look(watched)


KIND = Imu()
