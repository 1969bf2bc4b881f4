"""Inertial units: rates, gravity and attitude."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.core.device import DeviceKind, Figures, Plot, Topic, by_axis
from hil.core.finding import Finding, Level
from hil.core.geometry import Array
from hil.core.signals import ImuSample, Inputs, Status
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.imu.bno055.model import Bno055
from hil.drivers.imu.microstrain.model import MicroStrain
from hil.robot.statics import GRAVITY_M_S2

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND", "imu_message"]


_TOLERANCE_M_S2 = 0.5


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about an inertial unit that was watched."""
    yield losses("imu", (s.status for s in watched.samples), watched.due, "check wiring and baud rate")
    good = [s for s in watched.samples if s.status is Status.OK]
    if not good:
        return
    if good[-1].calibration:
        system, gyro, accelerometer, magnetometer = good[-1].calibration
        calibrated: Level = "ok" if min(gyro, accelerometer) >= 2 else "warning"
        yield Finding(
            "imu",
            "calibration",
            calibrated,
            f"system {system} gyro {gyro} accelerometer {accelerometer} magnetometer {magnetometer}",
            "gyro and accelerometer 2 or more",
            "hil run imu_calibration, or rest and tilt the robot",
        )
    norm = float(np.mean([np.linalg.norm(s.gravity_m_s2) for s in good]))
    level: Level = "ok" if abs(norm - GRAVITY_M_S2) < _TOLERANCE_M_S2 else "failure"
    yield Finding(
        "imu", "gravity", level, f"{norm:.2f} m/s^2", f"{GRAVITY_M_S2:.2f} m/s^2", "check the axis remap"
    )


_UNKNOWN = (0.0,) * 9
"""Covariance of `sensor_msgs/Imu` that is unknown: all zeros."""
_ABSENT = (-1.0, *(0.0,) * 8)
"""Covariance of a value that is not measured."""
_INSTEAD = ((0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
"""Orientation, rates and specific force in place of values that are not measured."""


def imu_message(sample: ImuSample, ros: MessageMaker) -> bytes | None:
    """`sensor_msgs/Imu` as CDR; acceleration with gravity (specific force), as in REP 145.

    What is not measured has a covariance that begins with -1, as the message's definition asks. None if
    nothing is.
    """
    w, x, y, z = sample.quaternion_wxyz.tolist()
    rates, force = sample.gyro_rad_s.tolist(), sample.specific_force_m_s2.tolist()
    if math.isfinite(w + x + y + z + sum(rates) + sum(force)):
        whole = (x, y, z, w, *_UNKNOWN, *rates, *_UNKNOWN, *force, *_UNKNOWN)
        return ros.numbers(sample.stamp.t_ns, ("imu",), whole)
    parts = ((x, y, z, w), rates, force)
    known = [all(map(math.isfinite, part)) for part in parts]
    values = [
        number
        for part, there, instead in zip(parts, known, _INSTEAD, strict=True)
        for number in (*(part if there else instead), *(_UNKNOWN if there else _ABSENT))
    ]
    return ros.numbers(sample.stamp.t_ns, ("imu",), values) if any(known) else None


class Imu(DeviceKind):
    """Rates, specific force and attitude."""

    name, noun, sample = "imu", "IMU", ImuSample
    models = (Bno055(), MicroStrain())
    max_age_s, max_gap_s, min_delivered = 0.02, 0.1, 0.95
    topics = (Topic("/imu/data", "sensor_msgs/msg/Imu", imu_message),)
    plots = (
        Plot("Sensors", "Turn rates (rad/s)", "imu/gyro_rad_s"),
        Plot("Sensors", "Specific force (m/s^2)", "imu/force_m_s2"),
    )
    motion_threshold = 0.2  # m/s^2: gravity turns with the robot, 0.17 for a degree
    silent_faults: ClassVar[Mapping[str, str]] = {
        "jump": "its own heading is not used, only gyro and gravity",
        "slow": "no check detects it: old values come as often as new ones would",
        "delayed": "no check detects it on a straight path: values of 0.1 s ago carry fresh stamps",
    }

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.imu_stale_s`."""
        return float(safety.imu_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Sample rate of its table, else the loop rate up to 100 Hz."""
        return float(getattr(config, "rate_hz", min(loop_hz, 100.0)))

    def motion_value(self, sample: ImuSample) -> Array | None:
        """Gravity (3,) in m/s^2."""
        return sample.gravity_m_s2 if sample.status is Status.OK else None

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Turn rates and specific force, in the sensor's frame."""
        if inputs.imu:
            yield "imu/gyro_rad_s", by_axis(inputs.imu[-1].gyro_rad_s)
            yield "imu/force_m_s2", by_axis(inputs.imu[-1].specific_force_m_s2)

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Findings on samples, calibration status and gravity."""
        return look(watched)


KIND = Imu()
