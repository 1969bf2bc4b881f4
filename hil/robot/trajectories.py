"""Trajectories: the reference pose of the robot over time.

A trajectory is a chain of segments (`hil.robot.paths`). Wall frame: X up the wall, Y to the left; heading
about the wall normal. SI units.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from hil.core.errors import UsageError, check_number
from hil.core.geometry import Array, ArrayLike, rotation2
from hil.core.signals import Reference
from hil.robot.kinematics import NOMINAL_HALF_BASE_M
from hil.robot.paths import Arc, Chain, Ints, Pose, Segment, Straight, TimeLaw

_STRIDE = 64
"""Segments per stride: a stride is found by bisection, the segment within it one by one."""

QUINTIC_PEAK_SPEED = 1.875
QUINTIC_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)


@dataclass(frozen=True)
class Trajectory:
    """A chain of segments; afterwards the reference stays at the last pose."""

    name: str
    segments: tuple[Segment, ...]

    @cached_property
    def duration_s(self) -> float:
        """Time from start to the last pose."""
        return sum(s.duration_s for s in self.segments)

    @cached_property
    def _strides(self) -> list[float]:
        """Start time, s, of every 64th segment, so that sampling costs the same along a long chain."""
        begins_s = [0.0, *accumulate(segment.duration_s for segment in self.segments)]
        return begins_s[: len(self.segments) : _STRIDE]

    def to_mapping(self) -> dict[str, Any]:
        """Plain data from which `from_mapping` restores the same trajectory exactly."""
        segments = [
            {
                "kind": type(part.path).__name__.lower(),
                "path": asdict(part.path),
                "duration_s": part.duration_s,
                "law": part.law,
            }
            for part in self.segments
        ]
        return {"name": self.name, "segments": segments}

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Trajectory:
        """Trajectory from the data of `to_mapping`; raises `UsageError` for anything else."""
        try:
            made = cls(str(data["name"]), tuple(_segment(part) for part in data["segments"]))
            made.sample(0.0)
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise UsageError(f"this is no trajectory ({error!r})", expected="what to_mapping wrote") from None
        return made

    def sample(self, t_s: float) -> Reference:
        """Reference at time `t_s`; the twist is in the reference's body frame."""
        stride = max(bisect_right(self._strides, t_s) - 1, 0)
        left = t_s - self._strides[stride]
        for k in range(stride * _STRIDE, len(self.segments)):
            segment = self.segments[k]
            if left < segment.duration_s:
                pose, velocity, acceleration = segment.at(max(left, 0.0))
                if t_s < 0.0:
                    velocity = acceleration = (0.0, 0.0, 0.0)
                return _reference(t_s, pose, velocity, acceleration, False)
            left -= segment.duration_s
        pose, _, _ = self.segments[-1].path(1.0)
        return _reference(t_s, pose, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True)

    def sample_many(self, times_s: ArrayLike) -> tuple[Array, Array, Array]:
        """`sample` for many times, equal up to rounding, at a twentieth of the cost.

        Args:
            times_s: (n,) times.

        Returns:
            Poses in the wall frame, twists in the reference's body frame and accelerations in wall axes,
            (n, 3) each; not finite where the segment is not finite.
        """
        t_s = np.asarray(times_s, dtype=np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            pose, velocity, acceleration = self._chain.at(*self._places(t_s))
            velocity[t_s < 0.0] = acceleration[t_s < 0.0] = 0.0
            c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
            ahead, left = c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]
        return pose, np.column_stack([ahead, left, velocity[:, 2]]), acceleration

    @cached_property
    def _chain(self) -> Chain:
        return Chain(self.segments)

    def _places(self, times_s: Array) -> tuple[Ints, Array]:
        """Index of the segment (n,) and the time within it (n,), bit for bit as in `sample`."""
        strides, durations_s = np.array(self._strides), np.append(self._chain.durations_s, math.inf)
        stride = np.maximum(np.searchsorted(strides, times_s, side="right") - 1, 0)
        k, left = stride * _STRIDE, times_s - strides[stride]
        later = np.flatnonzero(left >= durations_s[k])
        while later.size:
            left[later] -= durations_s[k[later]]
            k[later] += 1
            later = later[left[later] >= durations_s[k[later]]]
        return k, np.maximum(left, 0.0)


def _segment(data: Mapping[str, Any]) -> Segment:
    path = dict(data["path"])
    for key in ("start", "end"):
        if key in path:
            path[key] = _pose(path[key])
    kinds: dict[str, type[Straight | Arc]] = {"straight": Straight, "arc": Arc}
    law: TimeLaw = "constant" if data["law"] == "constant" else "quintic"
    return Segment(kinds[data["kind"]](**path), float(data["duration_s"]), law)


def _pose(value: ArrayLike) -> Pose:
    x, y, theta = np.asarray(value, dtype=np.float64).tolist()
    return (x, y, theta)


def _checked(value: ArrayLike, name: str) -> Array:
    """The value as a pose (3,); raises `UsageError` for anything else."""
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise UsageError(
            f"{name} is {value!r}", expected="a pose: three finite numbers x, y, theta (m, m, rad)"
        )
    return found


@lru_cache(maxsize=4)
def _into_body(heading_rad: float) -> Array:
    """Rotation (2, 2) from wall to body axes, read-only; cached, since the heading is often constant."""
    turn = rotation2(-heading_rad)
    turn.setflags(write=False)
    return turn


def _reference(t_s: float, pose: Pose, velocity: Pose, acceleration: Pose, done: bool) -> Reference:
    ahead, left = _into_body(pose[2]).dot(velocity[:2]).tolist()
    twist = np.array((ahead, left, velocity[2]))
    return Reference(t_s, np.array(pose), twist, np.array(acceleration), done)


def _duration(length: float, turn_rad: float, speed: float, acceleration: float, law: TimeLaw) -> float:
    """Duration of a segment within peak wheel speed and acceleration; a turn counts by the CAD lever."""
    check_number(speed, "speed_m_s", "m/s", above_zero=True)
    check_number(acceleration, "acceleration_m_s2", "m/s^2", above_zero=True)
    path = length + abs(turn_rad) * math.hypot(NOMINAL_HALF_BASE_M, NOMINAL_HALF_BASE_M)
    if path <= 0:
        raise UsageError("a segment of no length", expected="a start and an end that differ")
    if law == "constant":
        return path / speed
    return max(QUINTIC_PEAK_SPEED * path / speed, math.sqrt(QUINTIC_PEAK_ACCELERATION * path / acceleration))


def line(
    start: ArrayLike,
    end: ArrayLike,
    *,
    speed_m_s: float = 0.1,
    acceleration_m_s2: float = 0.2,
    duration_s: float | None = None,
    law: TimeLaw = "quintic",
    name: str = "line",
) -> Trajectory:
    """Straight line between two poses (3,) in the wall frame (m, m, rad); the heading changes linearly.

    Args:
        start: first pose.
        end: last pose.
        speed_m_s: largest wheel speed.
        acceleration_m_s2: largest wheel acceleration.
        duration_s: duration in place of that from the limits (checked later).
        law: `quintic` or `constant`.
        name: name shown in results.

    Raises:
        UsageError: an invalid pose, two equal poses, or a duration, speed or acceleration not above 0.
    """
    if duration_s is not None:
        check_number(duration_s, "duration_s", "s", above_zero=True)
    a, b = _checked(start, "start"), _checked(end, "end")
    length = float(np.hypot(*(b - a)[:2]))
    needed = _duration(length, float(b[2] - a[2]), speed_m_s, acceleration_m_s2, law)
    time_s = needed if duration_s is None else duration_s
    return Trajectory(name, (Segment(Straight(_pose(a), _pose(b)), time_s, law),))


def rotation(
    start: ArrayLike,
    angle_rad: float,
    *,
    speed_m_s: float = 0.1,
    acceleration_m_s2: float = 0.2,
    law: TimeLaw = "quintic",
    name: str = "rotation",
) -> Trajectory:
    """Turn on the spot, counter-clockwise for positive angles.

    Args:
        start: first pose, (3,) m, m, rad.
        angle_rad: angle to turn by.
        speed_m_s: largest wheel speed.
        acceleration_m_s2: largest wheel acceleration.
        law: `quintic` or `constant`.
        name: name shown in results.
    """
    pose = _checked(start, "start")
    end = pose + np.array([0.0, 0.0, angle_rad])
    return line(pose, end, speed_m_s=speed_m_s, acceleration_m_s2=acceleration_m_s2, law=law, name=name)


def circle(
    start: ArrayLike,
    radius_m: float,
    *,
    turns: float = 1.0,
    tangent: bool = True,
    speed_m_s: float = 0.1,
    acceleration_m_s2: float = 0.2,
    law: TimeLaw = "quintic",
    name: str = "circle",
) -> Trajectory:
    """Circle, counter-clockwise for positive `turns`, with tangent or fixed heading.

    Args:
        start: first pose, (3,) m, m, rad.
        radius_m: radius of the circle.
        turns: number of turns; negative is clockwise.
        tangent: True if the heading turns with the path.
        speed_m_s: largest wheel speed.
        acceleration_m_s2: largest wheel acceleration.
        law: `quintic` or `constant`.
        name: name shown in results.
    """
    angle = 2.0 * math.pi * turns
    turn = angle if tangent else 0.0
    time_s = _duration(abs(angle) * radius_m, turn, speed_m_s, acceleration_m_s2, law)
    return Trajectory(
        name, (Segment(Arc(_pose(_checked(start, "start")), radius_m, angle, tangent), time_s, law),)
    )


def scan(
    start: ArrayLike,
    length_m: float,
    lanes: int,
    spacing_m: float,
    *,
    speed_m_s: float = 0.1,
    acceleration_m_s2: float = 0.2,
    name: str = "scan",
) -> Trajectory:
    """Boustrophedon: lanes along X, stepping along Y, heading fixed, at rest in the corners.

    Args:
        start: first pose, (3,) m, m, rad.
        length_m: length of a lane.
        lanes: number of lanes.
        spacing_m: distance between neighbouring lanes.
        speed_m_s: largest wheel speed.
        acceleration_m_s2: largest wheel acceleration.
        name: name shown in results.

    Raises:
        UsageError: fewer than one lane.
    """
    if lanes < 1:
        raise UsageError(f"a scan of {lanes} lanes", expected="at least 1")
    x, y, theta = _checked(start, "start")
    points = []
    for lane in range(lanes):
        ends = (x, x + length_m) if lane % 2 == 0 else (x + length_m, x)
        points += [np.array([e, y + lane * spacing_m, theta]) for e in ends]
    return through(points, speed_m_s=speed_m_s, acceleration_m_s2=acceleration_m_s2, name=name)


def through(
    poses: Sequence[ArrayLike],
    *,
    speed_m_s: float = 0.1,
    acceleration_m_s2: float = 0.2,
    name: str = "waypoints",
) -> Trajectory:
    """Straight quintic segments through poses, at rest at each pose.

    Args:
        poses: (3,) each, (x m, y m, theta rad) in the wall frame.
        speed_m_s: largest wheel speed.
        acceleration_m_s2: largest wheel acceleration.
        name: name shown in results.

    Raises:
        UsageError: fewer than two poses.
    """
    if len(poses) < 2:
        raise UsageError(f"{len(poses)} waypoint(s)", expected="at least 2")
    parts = [
        line(a, b, speed_m_s=speed_m_s, acceleration_m_s2=acceleration_m_s2).segments[0]
        for a, b in pairwise(poses)
    ]
    return Trajectory(name, tuple(parts))


def recorded_motion(name: str) -> Trajectory:
    """Motion of the public recordings by name: constant speed, step start (arXiv 2509.04016).

    Raises:
        UsageError: another name.
    """
    origin = (0.0, 0.0, 0.0)
    v, w = 0.050, 0.157
    law: TimeLaw = "constant"
    sign = 1.0 if name.endswith("_ccw") else -1.0
    if name in ("line_x", "line_y"):
        end = (4.0, 0.0, 0.0) if name == "line_x" else (0.0, 4.0, 0.0)
        return Trajectory(name, (Segment(Straight(origin, end), 4.0 / v, law),))
    if name in ("circle_ccw", "circle_cw"):
        full = sign * 2.0 * math.pi
        return Trajectory(name, (Segment(Arc(origin, 0.5, full), math.pi / v, law),))
    if name in ("rotation_ccw", "rotation_cw"):
        turned = (0.0, 0.0, sign * 2.0 * math.pi)
        return Trajectory(name, (Segment(Straight(origin, turned), 2 * math.pi / w, law),))
    raise UsageError(
        f"motion {name!r}", expected="line_x, line_y, circle_ccw, circle_cw, rotation_ccw, rotation_cw"
    )
