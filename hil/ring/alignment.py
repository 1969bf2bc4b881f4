"""From device samples to body measurements and back: the only place that knows zeros, signs and mounts.

Everything before this module speaks the devices' own angles and frames, everything after it speaks
the body and wall frames of `hil.vocabulary.signals`. Deterministic: output depends on the inputs seen since
`reset` and on nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.vocabulary.errors import ConfigError
from hil.vocabulary.geometry import (
    Four,
    Three,
    conjugated,
    multiplied,
    rotated,
    wrap,
    yaw_of_quat,
)
from hil.vocabulary.signals import (
    GyroMeasurement,
    ImuSample,
    Inputs,
    Measurements,
    MocapSample,
    PoseMeasurement,
    ServoSample,
    ServoSetpoint,
    Status,
    TrackerSample,
    WheelMeasurement,
    WheelSetpoint,
)

_MIN_IN_PLANE_GRAVITY_M_S2 = 1.0
_FARTHEST_M = 1000.0
_USABLE = (Status.OK, Status.LOW_CONFIDENCE, Status.JUMP)


@dataclass(frozen=True)
class Mount:
    """Pose of a sensor in the body: position (3,) m, quaternion of sensor axes in body axes."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class AlignmentParameters:
    """Calibrated zeros, signs and mounts of one bench.

    Attributes:
        drive_sign, steer_sign: (4,) of +-1, wheel order.
        steer_zero_rad: (4,) servo angle at which the wheel points along body x.
        tracker_scale: way that the camera reports over the true way.
        on_wall: gravity lies in the motion plane.
    """

    drive_sign: tuple[int, ...] = (1, 1, 1, 1)
    steer_sign: tuple[int, ...] = (1, 1, 1, 1)
    steer_zero_rad: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    imu: Mount = Mount()
    tracker: Mount = Mount()
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
        self.reset()

    def reset(self) -> None:
        """Forget unwrapping state and the tracker's start frame."""
        self._yaw: dict[str, float] = {}
        self._tracker_start: tuple[Three, Four] | None = None

    def measure(self, inputs: Inputs) -> Measurements:
        """Body measurements of one cycle's inputs; unusable samples are left out or marked."""
        tracker = (self._tracker(s) for s in inputs.tracker)
        return Measurements(
            cycle=inputs.cycle,
            t_ns=inputs.t_ns,
            wheels=tuple(self._wheels(s) for s in inputs.servos),
            gyro=tuple(self._gyro(s) for s in inputs.imu if s.status is Status.OK),
            tracker=tuple(m for m in tracker if m is not None),
            mocap=tuple(self._mocap(s) for s in inputs.mocap),
        )

    def to_servos(self, setpoint: WheelSetpoint) -> ServoSetpoint:
        """Servo goals of a body setpoint."""
        return ServoSetpoint(
            drive_velocity_rad_s=self._drive_sign * setpoint.wheel_rate_rad_s,
            steer_position_rad=self._steer_sign * setpoint.steering_rad + self._zero,
        )

    def _wheels(self, sample: ServoSample) -> WheelMeasurement:
        valid = tuple(sample.status[i] is Status.OK and sample.status[i + 4] is Status.OK for i in range(4))
        return WheelMeasurement(
            stamp=sample.stamp,
            wheel_angle_rad=self._drive_sign * sample.position_rad[:4],
            wheel_rate_rad_s=self._drive_sign * sample.velocity_rad_s[:4],
            steering_rad=self._steer_sign * (sample.position_rad[4:] - self._zero),
            valid=valid,
        )

    def _gyro(self, sample: ImuSample) -> GyroMeasurement:
        mount = self.parameters.imu.rotation_wxyz
        rate = rotated(mount, sample.gyro_rad_s.tolist())
        up = rotated(mount, sample.gravity_m_s2.tolist())
        acceleration = rotated(mount, sample.linear_acceleration_m_s2.tolist())
        heading = math.nan
        if self.parameters.on_wall and math.hypot(up[0], up[1]) > _MIN_IN_PLANE_GRAVITY_M_S2:
            heading = self._unwrap("gravity", math.atan2(-up[1], up[0]))
        return GyroMeasurement(
            stamp=sample.stamp,
            yaw_rate_rad_s=rate[2],
            gravity_heading_rad=heading,
            acceleration_m_s2=np.array(acceleration[:2]),
        )

    def _tracker(self, sample: TrackerSample) -> PoseMeasurement | None:
        if sample.status not in _USABLE:
            return None
        px, py, pz = sample.position_m.tolist()
        turned = sample.quaternion_wxyz.tolist()
        if not (_is_near(px, py, pz) and _is_attitude(turned)):
            return None
        if self._tracker_start is None:
            if sample.status is not Status.OK:
                return None
            self._tracker_start = ((px, py, pz), tuple(turned))
        (sx, sy, sz), start_wxyz = self._tracker_start
        back = conjugated(start_wxyz)
        mount = self.parameters.tracker
        mount_m, mount_wxyz = mount.position_m, mount.rotation_wxyz
        turn = multiplied(mount_wxyz, multiplied(multiplied(back, turned), conjugated(mount_wxyz)))
        scale = self.parameters.tracker_scale
        way = ((px - sx) / scale, (py - sy) / scale, (pz - sz) / scale)
        moved = rotated(mount_wxyz, rotated(back, way))
        lever = rotated(turn, mount_m)
        yaw = self._unwrap("tracker", yaw_of_quat(turn))
        return PoseMeasurement(
            stamp=sample.stamp,
            source="tracker",
            pose=np.array([mount_m[0] + moved[0] - lever[0], mount_m[1] + moved[1] - lever[1], yaw]),
            quality=sample.confidence,
            valid=sample.status is Status.OK,
        )

    def _mocap(self, sample: MocapSample) -> PoseMeasurement:
        x, y = sample.position_m[:2].tolist()
        valid = sample.status is Status.OK and sample.tracking_valid
        valid = valid and _is_near(x, y) and _is_attitude(sample.quaternion_wxyz.tolist())
        yaw = math.nan
        if valid:
            yaw = self._unwrap("mocap", yaw_of_quat(sample.quaternion_wxyz))
        return PoseMeasurement(
            stamp=sample.stamp,
            source="mocap",
            pose=np.array([x, y, yaw]),
            quality=3 if valid else 0,
            valid=valid,
        )

    def _unwrap(self, source: str, yaw_rad: float) -> float:
        if not math.isfinite(yaw_rad):
            return math.nan
        last = self._yaw.get(source, yaw_rad)
        self._yaw[source] = last + wrap(yaw_rad - last)
        return self._yaw[source]


def _is_near(*position_m: float) -> bool:
    """Whether a position can be one: finite, and on any wall that there is."""
    return all([abs(p) < _FARTHEST_M for p in position_m])


def _is_attitude(quaternion_wxyz: list[float]) -> bool:
    """Whether it is a unit quaternion as devices send them; what is not would spoil every later heading."""
    return 0.9 < sum(q * q for q in quaternion_wxyz) < 1.1
