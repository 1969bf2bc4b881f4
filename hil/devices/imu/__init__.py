"""Inertial units: rates, gravity and attitude."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hil.devices.imu.bno055 import BNO055
from hil.devices.imu.look import look
from hil.devices.imu.microstrain import MICROSTRAIN
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Topic, Witness
from hil.vocabulary.signals import ImuSample, Status

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "imu_message"]

_UNKNOWN = np.zeros(9)
"""A covariance, as `sensor_msgs/Imu` has it where nothing is known of it."""


def imu_message(sample: ImuSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/Imu`; acceleration with gravity (specific force), as REP 145 asks."""
    return ros.message(
        "sensor_msgs/msg/Imu",
        header=ros.header(sample.stamp.t_ns, "imu"),
        orientation=ros.quaternion(sample.quaternion_wxyz),
        orientation_covariance=_UNKNOWN,
        angular_velocity=ros.vector(sample.gyro_rad_s),
        angular_velocity_covariance=_UNKNOWN,
        linear_acceleration=ros.vector(sample.specific_force_m_s2),
        linear_acceleration_covariance=_UNKNOWN,
    )


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
