"""Poses of the camera and of motion capture as poses of the body: mounts, scale, start frame, unwrapping."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.vocabulary.geometry import Four, Three, conjugated, multiplied, rotated, wrap, yaw_of_quat
from hil.vocabulary.signals import Inputs, MocapSample, PoseMeasurement, Status, TrackerSample

_FARTHEST_M = 1000.0
_NOWHERE = np.full(3, np.nan)
_USABLE = (Status.OK, Status.LOW_CONFIDENCE, Status.JUMP)


@dataclass(frozen=True)
class Mount:
    """Pose of a sensor in the body: position (3,) m, quaternion of sensor axes in body axes."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


AT_ORIGIN = Mount()
"""Of a sensor at the body's origin, along its axes."""


class Unwrapped:
    """An angle that is followed over its turns."""

    def __init__(self) -> None:
        self._last_rad: float | None = None

    def follow(self, angle_rad: float) -> float:
        """The next value, within half a turn of the one before; NaN stays NaN and is not followed."""
        if not math.isfinite(angle_rad):
            return math.nan
        last_rad = angle_rad if self._last_rad is None else self._last_rad
        self._last_rad = last_rad + wrap(angle_rad - last_rad)
        return self._last_rad


class PoseAlignment:
    """Turns pose samples into measurements of the body.

    Args:
        mount: of the camera.
        scale: distance that the camera reports over the true distance.
    """

    def __init__(self, mount: Mount, scale: float) -> None:
        self._mount, self._scale = mount, scale
        self._unmounted = conjugated(mount.rotation_wxyz)
        self.reset()

    def reset(self) -> None:
        """Forget unwrapping state and the camera's start frame."""
        self._mocap_yaw = Unwrapped()
        self._forget_start()

    def _forget_start(self) -> None:
        self._tracker_yaw = Unwrapped()
        self._start: tuple[Three, Four] | None = None  # where the camera began, and its attitude, conjugated

    def measure(self, inputs: Inputs) -> dict[str, tuple[PoseMeasurement, ...]]:
        """Measurements by the names that they have in `Measurements`."""
        camera = [self._tracker(s) for s in inputs.tracker]
        return {
            "tracker": tuple([m for m in camera if m is not None]),
            "mocap": tuple([self._mocap(s) for s in inputs.mocap]),
        }

    def _tracker(self, sample: TrackerSample) -> PoseMeasurement | None:
        """The body's pose in the frame of the first good one; None without a usable one.

        A camera that has started again has another frame. Where it looks up a wall, that is turned about
        the vertical by any angle. It begins with the next good pose; the reset itself is told as a pose that
        is not valid.
        """
        if sample.status is Status.RESET:
            self._forget_start()
            return PoseMeasurement(sample.stamp, "tracker", _NOWHERE, sample.confidence, valid=False)
        if sample.status not in _USABLE:
            return None
        px, py, pz = sample.position_m.tolist()
        turned = sample.quaternion_wxyz.tolist()
        if not (_is_near(px, py, pz) and _is_attitude(turned)):
            return None
        if self._start is None:
            if sample.status is not Status.OK:
                return None
            self._start = ((px, py, pz), conjugated(turned))
        (sx, sy, sz), back = self._start
        mount_m, mount_wxyz = self._mount.position_m, self._mount.rotation_wxyz
        turn = multiplied(mount_wxyz, multiplied(multiplied(back, turned), self._unmounted))
        scale = self._scale
        way = ((px - sx) / scale, (py - sy) / scale, (pz - sz) / scale)
        moved = rotated(mount_wxyz, rotated(back, way))
        lever = rotated(turn, mount_m)
        yaw = self._tracker_yaw.follow(yaw_of_quat(turn))
        return PoseMeasurement(
            stamp=sample.stamp,
            source="tracker",
            pose=np.array([mount_m[0] + moved[0] - lever[0], mount_m[1] + moved[1] - lever[1], yaw]),
            quality=sample.confidence,
            valid=sample.status is Status.OK,
        )

    def _mocap(self, sample: MocapSample) -> PoseMeasurement:
        x, y, _ = sample.position_m.tolist()
        turned = sample.quaternion_wxyz.tolist()
        valid = sample.status is Status.OK and sample.tracking_valid
        valid = valid and _is_near(x, y) and _is_attitude(turned)
        yaw = self._mocap_yaw.follow(yaw_of_quat(turned)) if valid else math.nan
        return PoseMeasurement(
            stamp=sample.stamp,
            source="mocap",
            pose=np.array([x, y, yaw]),
            quality=3 if valid else 0,
            valid=valid,
        )


def _is_near(x_m: float, y_m: float, z_m: float = 0.0) -> bool:
    """Whether a position can be one: finite, and on any wall that there is."""
    return (
        -_FARTHEST_M < x_m < _FARTHEST_M
        and -_FARTHEST_M < y_m < _FARTHEST_M
        and -_FARTHEST_M < z_m < _FARTHEST_M
    )


def _is_attitude(quaternion_wxyz: list[float]) -> bool:
    """Whether it is a unit quaternion as devices send them; what is not would spoil every later heading."""
    w, x, y, z = quaternion_wxyz
    return 0.9 < w * w + x * x + y * y + z * z < 1.1
