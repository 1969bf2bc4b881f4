"""Converts device samples to body measurements and back; only this module applies zeros, signs and mounts.

Upstream of this module, angles and frames are the devices' own; downstream they are the body and wall frames
of `hil.core.signals`. Deterministic: the output depends only on the inputs since `reset`.
"""

import math
from dataclasses import dataclass

import numpy as np

from hil.core.errors import ConfigError
from hil.core.geometry import rotated
from hil.core.signals import (
    SERVOS,
    GyroMeasurement,
    ImuSample,
    Inputs,
    Measurements,
    ServoSample,
    ServoSetpoint,
    Status,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.loop.pose_alignment import AT_ORIGIN, Mount, PoseAlignment, Unwrapped

_MIN_IN_PLANE_GRAVITY_M_S2 = 1.0
_OK = Status.OK
_ALL_OK, _ALL_VALID = (_OK,) * len(SERVOS), (True,) * 4


@dataclass(frozen=True)
class AlignmentParameters:
    """Calibrated zeros, signs and mounts of one bench.

    Attributes:
        drive_sign, steer_sign: signs (4,) of +-1, wheel order.
        steer_zero_rad: (4,) servo angle at which the wheel points along body x.
        tracker_scale: distance that the camera reports over the true distance.
        on_wall: True if gravity lies in the motion plane.
    """

    drive_sign: tuple[int, ...] = (1, 1, 1, 1)
    steer_sign: tuple[int, ...] = (1, 1, 1, 1)
    steer_zero_rad: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    imu: Mount = AT_ORIGIN
    tracker: Mount = AT_ORIGIN
    tracker_scale: float = 1.0
    on_wall: bool = True

    def __post_init__(self) -> None:
        for name in ("drive_sign", "steer_sign", "steer_zero_rad"):
            if len(getattr(self, name)) != 4:
                raise ConfigError(f"alignment.{name} needs four values, wheel order FL, BL, BR, FR")


class Alignment:
    """Applies `AlignmentParameters` in both directions."""

    def __init__(self, parameters: AlignmentParameters) -> None:
        self.parameters = parameters
        self._drive_sign = np.array(parameters.drive_sign, dtype=np.float64)
        self._steer_sign = np.array(parameters.steer_sign, dtype=np.float64)
        self._zero = np.array(parameters.steer_zero_rad, dtype=np.float64)
        self._signs = np.concatenate([self._drive_sign, self._steer_sign])
        self._zeros = np.concatenate([np.zeros(4), self._zero])
        self._as_they_are = bool((self._signs == 1.0).all()) and not self._zeros.any()
        self._poses = PoseAlignment(parameters.tracker, parameters.tracker_scale)
        self.reset()

    def reset(self) -> None:
        """Clear the unwrapping state and the camera's start frame."""
        self._heading = Unwrapped()
        self._poses.reset()

    def measure(self, inputs: Inputs) -> Measurements:
        """Body measurements of one cycle's inputs; unusable samples are left out or marked."""
        return Measurements(
            inputs.cycle,
            inputs.t_ns,
            tuple([self._wheels(s) for s in inputs.servos]),
            tuple([self._gyro(s) for s in inputs.imu if s.status is _OK]),
            *self._poses.measure(inputs),
            inputs.added,
        )

    def to_servos(self, setpoint: WheelSetpoint) -> ServoSetpoint:
        """Servo goals of a body setpoint."""
        if self._as_they_are:
            return ServoSetpoint(setpoint.wheel_rate_rad_s, setpoint.steering_rad + self._zero)
        return ServoSetpoint(
            self._drive_sign * setpoint.wheel_rate_rad_s,
            self._steer_sign * setpoint.steering_rad + self._zero,
        )

    def _wheels(self, sample: ServoSample) -> WheelMeasurement:
        valid = _ALL_VALID
        if sample.status != _ALL_OK:
            ok = [status is _OK for status in sample.status]
            valid = (ok[0] and ok[4], ok[1] and ok[5], ok[2] and ok[6], ok[3] and ok[7])
        angles, rates = sample.position_rad, sample.drive_rad_s
        if not self._as_they_are:
            angles, rates = self._signs * (angles - self._zeros), self._drive_sign * rates
        return WheelMeasurement(sample.stamp, angles[:4], rates, angles[4:], valid)

    def _gyro(self, sample: ImuSample) -> GyroMeasurement:
        mount = self.parameters.imu.rotation_wxyz
        _, _, yaw_rate = rotated(mount, sample.gyro_rad_s.tolist())
        up_x, up_y, _ = rotated(mount, sample.gravity_m_s2.tolist())
        acceleration = rotated(mount, sample.linear_acceleration_m_s2.tolist())
        heading = math.nan
        if self.parameters.on_wall and math.hypot(up_x, up_y) > _MIN_IN_PLANE_GRAVITY_M_S2:
            heading = self._heading.follow(math.atan2(-up_y, up_x))
        return GyroMeasurement(sample.stamp, yaw_rate, heading, np.array(acceleration[:2]))
