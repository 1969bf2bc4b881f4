"""The frame tree of a recording: the parent and pose of each coordinate frame, from header and cycles.

`wall` is the root (the `map` of REP 105) and `body` the robot (`base_link`), carried by the estimate. Fixed
to the robot are its sensors and wheels; the capture system's frame is the wall's own. The camera's poses are
relative to its start. The start is placed where the estimate had the camera in the first cycle of each run
with a good pose, so that the drift of the camera stays visible.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.clock import WallOffset
from hil.core.geometry import Array, conjugated, multiplied, rotated
from hil.core.signals import WHEELS, CycleRecord, Status, TrackerSample

WALL, BODY, CAMERA, CAMERA_START, CAPTURE = "wall", "body", "tracker", "tracker_start", "mocap"
VIRTUAL, MONOTONIC = "virtual", "monotonic"

_UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Frame(NamedTuple):
    """Pose of a frame: origin (3,) m and axes as a quaternion, both in its parent."""

    parent: str
    child: str
    position_m: tuple[float, ...]
    quaternion_wxyz: tuple[float, ...]


def describe_clock(offset: WallOffset | None, ptp: Sequence[Mapping[str, object]] = ()) -> dict[str, object]:
    """Entry of a header for the clock of the stamps; `offset` is None for virtual time.

    `ptp` holds the offsets of hardware clocks, where there are any.
    """
    if offset is None:
        return {"kind": VIRTUAL}
    return {"kind": MONOTONIC, **offset._asdict(), **({"ptp": list(ptp)} if ptp else {})}


def recorded_offset(header: Mapping[str, Any]) -> WallOffset | None:
    """Wall-clock offset in a header; None for virtual time and for recordings that do not say."""
    clock = header.get("clock")
    if not isinstance(clock, Mapping) or clock.get("kind") != MONOTONIC:
        return None
    return WallOffset(*(int(clock[name]) for name in WallOffset._fields))


def fixed_frames(header: Mapping[str, Any]) -> tuple[Frame, ...]:
    """Frames that never move: the capture system's, sensors and wheels as far as the header knows them."""
    found = [Frame(WALL, CAPTURE, (0.0, 0.0, 0.0), _UPRIGHT)]
    config = header.get("config", {})
    for name, device in config.items():
        if isinstance(device, Mapping) and "mount_position_m" in device:
            place, axes = tuple(device["mount_position_m"]), tuple(device["mount_rotation_wxyz"])
            found.append(Frame(BODY, name, place, axes))
    if "geometry" in header:
        x_m, y_m, radius_m, _ = np.array(header["geometry"], dtype=np.float64).reshape(4, 4)
        found += [
            Frame(BODY, f"wheel_{wheel}", (float(x_m[i]), float(y_m[i]), float(radius_m[i])), _UPRIGHT)
            for i, wheel in enumerate(WHEELS)
        ]
    return tuple(found)


class FrameTree:
    """Frames of one recording.

    Args:
        header: header of the recording.

    Attributes:
        fixed: frames that never move.
        camera_start: pose at which the camera began, in this run; None until that is known.
    """

    def __init__(self, header: Mapping[str, Any]) -> None:
        self.fixed = fixed_frames(header)
        self.camera_start: Frame | None = None
        self._camera = next((f for f in self.fixed if f.child == CAMERA), None)
        self._latest_cycle = -1

    def follow(self, record: CycleRecord) -> bool:
        """Find the camera's start in a cycle; returns whether the cycle estimates the body's pose."""
        if record.cycle <= self._latest_cycle:
            self.camera_start = None
        self._latest_cycle = record.cycle
        x_m, y_m, theta_rad = record.state.pose_body_in_wall.tolist()
        if not (math.isfinite(x_m) and math.isfinite(y_m) and math.isfinite(theta_rad)):
            return False
        if self.camera_start is None and self._camera is not None:
            good = (s for s in record.inputs.tracker if s.status is Status.OK and _is_known(s))
            body = Frame(WALL, BODY, (x_m, y_m, 0.0), _turned(theta_rad))
            self.camera_start = next((_start_of(body, self._camera, s) for s in good), None)
        return True


def _finite(values: Array) -> bool:
    return all(map(math.isfinite, values.tolist()))


def _is_known(sample: TrackerSample) -> bool:
    return _finite(sample.position_m) and _finite(sample.quaternion_wxyz)


def _turned(theta_rad: float) -> tuple[float, ...]:
    """Quaternion of a rotation about z."""
    return math.cos(0.5 * theta_rad), 0.0, 0.0, math.sin(0.5 * theta_rad)


def _start_of(body: Frame, camera: Frame, sample: TrackerSample) -> Frame:
    """The camera's start frame in the wall, from its present frame and its reported pose."""
    turn = multiplied(body.quaternion_wxyz, camera.quaternion_wxyz)
    axes = multiplied(turn, conjugated(sample.quaternion_wxyz.tolist()))
    place: Array = (
        np.array(body.position_m)
        + rotated(body.quaternion_wxyz, camera.position_m)
        - rotated(axes, sample.position_m.tolist())
    )
    return Frame(WALL, CAMERA_START, tuple(place.tolist()), axes)
