"""Inertial units: rates, gravity and attitude."""

from __future__ import annotations

from hil.devices.imu.bno055 import BNO055
from hil.devices.imu.look import look
from hil.devices.imu.microstrain import MICROSTRAIN
from hil.recording.cdr import NO_COVARIANCE, TIME, CdrForm, Doubles, xyzw
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Topic, Witness
from hil.vocabulary.signals import ImuSample, Status

__all__ = ["KIND", "imu_message"]

_MESSAGE = CdrForm(TIME, "imu", Doubles(37))


def imu_message(sample: ImuSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/Imu`; acceleration with gravity (specific force), as REP 145 asks."""
    numbers = (
        *xyzw(sample.quaternion_wxyz),
        *NO_COVARIANCE,
        *sample.gyro_rad_s.tolist(),
        *NO_COVARIANCE,
        *sample.specific_force_m_s2.tolist(),
        *NO_COVARIANCE,
    )
    return _MESSAGE.pack(sample.stamp.t_ns, wall_ns, numbers)


def _gravity(sample: ImuSample) -> Array | None:
    return sample.gravity_m_s2 if sample.status is Status.OK else None


KIND = DeviceKind(
    name="imu",
    noun="IMU",
    sample=ImuSample,
    models=(BNO055, MICROSTRAIN),
    stale_s=lambda safety, own: safety.imu_stale_s,
    rate_hz=lambda own, loop_hz: float(getattr(own, "rate_hz", min(loop_hz, 100.0))),
    age_s=0.02,
    gap_s=0.1,
    delivered=0.95,
    topics=(Topic("/imu/data", "sensor_msgs/msg/Imu", imu_message),),
    witness=Witness(still=0.2, value=_gravity),  # m/s^2: gravity turns with the robot, 0.17 for a degree
    look=look,
    passes={
        "jump": "its own heading is not used: gyro and gravity are",
        "slow": "nobody notices: values of a moment ago come as often as new ones would",
        "delayed": "nobody notices on a straight way: values of 0.1 s ago carry fresh stamps",
    },
)
