"""Converts poses of camera and motion capture to body poses: mounts, scale, start frame, unwrapping."""

import math
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array, Three, conjugated, multiplied, rotated, wrap
from hil.core.signals import Inputs, MocapSample, PoseMeasurement, Status, TrackerSample
from hil.support.numba_jit import compile_for, inner, kernel

for _plain in (conjugated, multiplied, rotated, wrap):
    inner(_plain)

_FARTHEST_M = 1000.0
_NOWHERE = np.full(3, np.nan)
_OK, _RESET = Status.OK, Status.RESET
_USABLE = (Status.OK, Status.LOW_CONFIDENCE, Status.JUMP)

# A camera (15,): position and attitude on the body, scale of its distances, position at the start, and
# conjugated attitude at the start.
_PLACE, _TURN, _SCALE, _START, _BACK = 0, 3, 7, 8, 11


@dataclass(frozen=True)
class Mount:
    """Pose of a sensor in the body: position (3,) m, quaternion of sensor axes in body axes."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


AT_ORIGIN = Mount()
"""Mount of a sensor at the body's origin, along the body's axes."""


class Unwrapped:
    """An angle that is unwrapped over several turns."""

    def __init__(self) -> None:
        self._last_rad: float | None = None

    def follow(self, angle_rad: float) -> float:
        """Unwrap the next value, within half a turn of the previous one; NaN stays NaN and is skipped."""
        if not math.isfinite(angle_rad):
            return math.nan
        last_rad = angle_rad if self._last_rad is None else self._last_rad
        self._last_rad = last_rad + wrap(angle_rad - last_rad)
        return self._last_rad


class PoseAlignment:
    """Converts pose samples to measurements of the body.

    Args:
        mount: mount of the camera.
        scale: distance that the camera reports over the true distance.
    """

    def __init__(self, mount: Mount, scale: float) -> None:
        self._camera = np.array((*mount.position_m, *mount.rotation_wxyz, scale, *[0.0] * 7))
        compile_for(_seen_from, self._camera, *[0.0] * 7)
        self.reset()

    def reset(self) -> None:
        """Clear the unwrapping state and the camera's start frame."""
        self._mocap_yaw = Unwrapped()
        self._forget_start()

    def _forget_start(self) -> None:
        self._tracker_yaw = Unwrapped()
        self._began = False

    def measure(self, inputs: Inputs) -> tuple[tuple[PoseMeasurement, ...], tuple[PoseMeasurement, ...]]:
        """Measurements of the camera, and those of motion capture."""
        camera = [self._tracker(s) for s in inputs.tracker]
        return tuple([m for m in camera if m is not None]), tuple([self._mocap(s) for s in inputs.mocap])

    def _tracker(self, sample: TrackerSample) -> PoseMeasurement | None:
        """Body pose in the frame of the first good pose; None without a usable pose.

        A restarted camera has a new frame; if it points up a wall, this is rotated about the vertical by any
        angle. The new frame begins with the next good pose; the restart itself gives an invalid pose.
        """
        status = sample.status
        if status is _RESET:
            self._forget_start()
            return PoseMeasurement(sample.stamp, "tracker", _NOWHERE, sample.confidence, False)
        if status not in _USABLE:
            return None
        px, py, pz = sample.position_m.tolist()
        w, x, y, z = sample.quaternion_wxyz.tolist()
        if not self._began:
            if status is not _OK or not _is_pose(px, py, pz, w, x, y, z):
                return None
            self._began = True
            self._camera[_START:] = (px, py, pz, *conjugated((w, x, y, z)))
        x_m, y_m, yaw_rad = _seen_from(self._camera, px, py, pz, w, x, y, z)
        if math.isnan(yaw_rad):
            return None
        pose = np.array((x_m, y_m, self._tracker_yaw.follow(yaw_rad)))
        return PoseMeasurement(sample.stamp, "tracker", pose, sample.confidence, status is _OK)

    def _mocap(self, sample: MocapSample) -> PoseMeasurement:
        x_m, y_m, _ = sample.position_m.tolist()
        w, x, y, z = sample.quaternion_wxyz.tolist()
        valid = sample.status is _OK and sample.tracking_valid
        valid = valid and _is_pose(x_m, y_m, 0.0, w, x, y, z)
        yaw = self._mocap_yaw.follow(_yaw(w, z)) if valid else math.nan
        return PoseMeasurement(sample.stamp, "mocap", np.array((x_m, y_m, yaw)), 3 if valid else 0, valid)


@inner
def _is_pose(x_m: float, y_m: float, z_m: float, w: float, x: float, y: float, z: float) -> bool:
    """Whether a pose is plausible: position within any real wall, and quaternion of unit length.

    An implausible pose would corrupt every later heading.
    """
    return (
        -_FARTHEST_M < x_m < _FARTHEST_M
        and -_FARTHEST_M < y_m < _FARTHEST_M
        and -_FARTHEST_M < z_m < _FARTHEST_M
        and 0.9 < w * w + x * x + y * y + z * z < 1.1
    )


@inner
def _yaw(w: float, z: float) -> float:
    """Rotation as of `yaw_of_quat`, from the components w and z of a quaternion."""
    return wrap(2.0 * math.atan2(z, w))


@kernel
def _seen_from(
    camera: Array, px: float, py: float, pz: float, w: float, x: float, y: float, z: float
) -> Three:
    """Body pose relative to that at the camera's start, in the body axes at the start.

    Args:
        camera: (15,) camera data.
        px: position of the camera in its own frame, x, m.
        py: y (left), m.
        pz: z (up), m.
        w: attitude quaternion of the camera in its own frame, w.
        x: component x.
        y: component y.
        z: component z.

    Returns:
        x and y (m) and heading (rad); NaN where the camera gives no pose.
    """
    if not _is_pose(px, py, pz, w, x, y, z):
        return math.nan, math.nan, math.nan
    place = (camera[_PLACE], camera[_PLACE + 1], camera[_PLACE + 2])
    mounted = (camera[_TURN], camera[_TURN + 1], camera[_TURN + 2], camera[_TURN + 3])
    back = (camera[_BACK], camera[_BACK + 1], camera[_BACK + 2], camera[_BACK + 3])
    scale = camera[_SCALE]
    way = (
        (px - camera[_START]) / scale,
        (py - camera[_START + 1]) / scale,
        (pz - camera[_START + 2]) / scale,
    )
    turn = multiplied(mounted, multiplied(multiplied(back, (w, x, y, z)), conjugated(mounted)))
    moved, lever = rotated(mounted, rotated(back, way)), rotated(turn, place)
    x_m, y_m = place[0] + moved[0] - lever[0], place[1] + moved[1] - lever[1]
    return x_m, y_m, _yaw(turn[0], turn[3])
