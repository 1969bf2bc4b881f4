"""Checks, before anything moves, that a robot can follow a trajectory."""

import math
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from hil.core.errors import TrajectoryError
from hil.core.geometry import Array
from hil.robot.trajectories import Trajectory

_CHECK_STEP_S = 0.01
_LEAST_TIMES = 32
"""Least number of sample times per segment; short segments get additional ones."""
_LONGEST_S = 7200.0
_AT_ONCE = 20000
_SLACK = 1.0 + 1e-6
_MARGIN = 1e-3
_OTHERWISE = "change the shape of the motion"
_OF_WHEELS = 2
"""Number of leading limits that belong to the wheels: speed and acceleration."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits that a trajectory must respect at every time.

    Attributes:
        wheel_speed_m_s, wheel_acceleration_m_s2: largest speed and acceleration of each wheel.
        heading_limit_rad: largest heading on a wall, either side; None on the floor.
        friction_rad: lowest and highest heading at which no wheel uses more than its share of friction; None
            where that is not known, or on the floor.
        x_range_m, y_range_m: usable part of the wall; None for no bound.
    """

    wheel_speed_m_s: float = 0.122
    wheel_acceleration_m_s2: float = 0.2
    heading_limit_rad: float | None = None
    friction_rad: tuple[float, float] | None = None
    x_range_m: tuple[float, float] | None = None
    y_range_m: tuple[float, float] | None = None


def check(
    trajectory: Trajectory, projection: Array, limits: MotionLimits, *, known: Trajectory | None = None
) -> None:
    """Refuse a trajectory that exceeds a limit.

    Args:
        trajectory: trajectory to check.
        projection: P (8, 3) of the wheels, `WheelGeometry.projection()`.
        limits: limits that must hold at every time.
        known: trajectory already checked against these limits; segments that both end with are skipped.

    Raises:
        TrajectoryError: a limit is exceeded; names the first time at which it is, and the value.
    """
    if not trajectory.duration_s <= _LONGEST_S:
        raise TrajectoryError(
            trajectory.name,
            t_s=0.0,
            quantity="duration (s)",
            value=trajectory.duration_s,
            limit=_LONGEST_S,
            remedy="divide the motion",
        )
    until_s = trajectory.duration_s if known is None else _new_s(trajectory, known)
    times_s = _times_s(trajectory, until_s)
    for begin in range(0, len(times_s), _AT_ONCE):
        _check(trajectory, times_s[begin : begin + _AT_ONCE], projection, limits)


def slowed(trajectory: Trajectory, projection: Array, limits: MotionLimits, *, at_most: float) -> Trajectory:
    """The same path, slowed as far as the wheels need to keep to their speed and acceleration limits.

    Args:
        trajectory: requested trajectory.
        projection: P (8, 3) of the wheels.
        limits: limits, of which only those of the wheels are used.
        at_most: largest factor on the duration; beyond it the trajectory is unchanged and `check` refuses it.
    """
    longer = _times_as_long(trajectory, projection, limits)
    if longer <= 1.0 or not longer <= at_most:
        return trajectory
    longer *= 1.0 + _MARGIN
    slower = tuple(replace(part, duration_s=part.duration_s * longer) for part in trajectory.segments)
    return replace(trajectory, segments=slower)


def _times_as_long(trajectory: Trajectory, projection: Array, limits: MotionLimits) -> float:
    """Factor on the duration at which the wheels just keep to their speed and acceleration limits."""
    pose, twist, pull = trajectory.sample_many(_times_s(trajectory, trajectory.duration_s))
    speed, acceleration = (
        q.values.max() / q.limit for q in _held(pose, twist, pull, projection, limits)[:_OF_WHEELS]
    )
    return float(max(speed, math.sqrt(acceleration)))


def _times_s(trajectory: Trajectory, until_s: float) -> Array:
    """Sample times in rising order: equal steps, and additional ones within short segments.

    A short segment may start and end at rest, or lie between two steps.

    Args:
        trajectory: trajectory to sample.
        until_s: last time, s.
    """
    steps_s = np.arange(0.0, until_s + _CHECK_STEP_S, _CHECK_STEP_S)
    short, begin_s = [], 0.0
    for part in trajectory.segments:
        if begin_s >= until_s:
            break
        if part.duration_s < _LEAST_TIMES * _CHECK_STEP_S:
            short.append((begin_s, part.duration_s))
        begin_s += part.duration_s
    if not short:
        return steps_s
    begins_s, durations_s = np.array(short).T[:, :, None]
    parts = (np.arange(_LEAST_TIMES) + 0.5) / _LEAST_TIMES
    return np.union1d(steps_s, begins_s + parts * durations_s)


def _new_s(trajectory: Trajectory, known: Trajectory) -> float:
    """Time, s, until the final segments that `trajectory` shares with `known` (the same objects) begin."""
    pairs = zip(reversed(trajectory.segments), reversed(known.segments), strict=False)
    shared = sum(1 for _ in takewhile(lambda pair: pair[0] is pair[1], pairs))
    return sum(part.duration_s for part in trajectory.segments[: len(trajectory.segments) - shared])


def _check(trajectory: Trajectory, times_s: Array, projection: Array, limits: MotionLimits) -> None:
    """Refuse the first of the times at which a limit is exceeded or the reference is not finite."""
    pose, twist, pull = trajectory.sample_many(times_s)
    finite = np.isfinite(pose).all(axis=1) & np.isfinite(twist).all(axis=1)
    known = len(times_s) if finite.all() else int(np.argmin(finite))
    held = _held(pose[:known], twist[:known], pull[:known], projection, limits)
    beyond = np.array([~(q.values <= q.limit + abs(q.limit) * (_SLACK - 1.0) + 1e-12) for q in held])
    if beyond.any():
        k = int(np.argmax(beyond.any(axis=0)))
        which = int(np.argmax(beyond[:, k]))
        first = held[which]
        raise TrajectoryError(
            trajectory.name,
            t_s=float(times_s[k]),
            quantity=first.name,
            value=float(first.values[k]),
            limit=first.limit,
            remedy=_slower(trajectory, projection, limits) if which < _OF_WHEELS else _OTHERWISE,
        )
    if known < len(times_s):
        raise TrajectoryError(
            trajectory.name, t_s=float(times_s[known]), quantity="reference", value=math.nan, limit=math.inf
        )


def _slower(trajectory: Trajectory, projection: Array, limits: MotionLimits) -> str:
    """Remedy for too fast wheels: the least duration, where one exists."""
    lasts_s = trajectory.duration_s
    takes_s = _times_as_long(trajectory, projection, limits) * lasts_s
    if not (math.isfinite(takes_s) and takes_s > 0.0):
        return _OTHERWISE
    rounded_s = math.ceil(10.0 * takes_s) / 10.0
    return f"let the same way take {rounded_s:g} s instead of {lasts_s:.3g} s, or {_OTHERWISE}"


class _Held(NamedTuple):
    """A limited quantity: values (n,) over time, and the limit."""

    name: str
    values: Array
    limit: float


def _held(pose: Array, twist: Array, pull: Array, projection: Array, limits: MotionLimits) -> list[_Held]:
    """The limited quantities, in the order in which they are reported.

    Args:
        pose: poses (n, 3) in the wall frame.
        twist: twists (n, 3) in the body frame.
        pull: (n, 3) accelerations in wall axes.
        projection: P (8, 3) of the wheels.
        limits: limits to apply.
    """
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ahead, left = c * pull[:, 0] + s * pull[:, 1], c * pull[:, 1] - s * pull[:, 0]
    body = np.column_stack([ahead, left, pull[:, 2]])
    found = [
        _Held("wheel speed (m/s)", _fastest(twist, projection), limits.wheel_speed_m_s),
        _Held("wheel acceleration (m/s^2)", _fastest(body, projection), limits.wheel_acceleration_m_s2),
    ]
    if limits.heading_limit_rad is not None:
        found.append(_Held("heading on the wall (rad)", np.abs(pose[:, 2]), limits.heading_limit_rad))
    if limits.friction_rad is not None and len(pose):
        low_rad, high_rad = limits.friction_rad
        start_rad = float(pose[0, 2])  # from beyond it there has to be a way back
        low_rad, high_rad = min(low_rad, start_rad), max(high_rad, start_rad)
        label = "heading on the wall (rad), by safety.utilisation_limit"
        found += [_Held(label, pose[:, 2], high_rad), _Held(f"-{label}", -pose[:, 2], -low_rad)]
    for axis, bounds in enumerate((limits.x_range_m, limits.y_range_m)):
        if bounds is not None:
            label = f"{'xy'[axis]} on the wall (m)"
            found += [_Held(label, pose[:, axis], bounds[1]), _Held("-" + label, -pose[:, axis], -bounds[0])]
    return found


def _fastest(motion: Array, projection: Array) -> Array:
    """Largest of the four wheel speeds (or accelerations), (n,), of body motions (n, 3)."""
    wheels = motion @ projection.T
    return np.asarray(np.hypot(wheels[:, 0::2], wheels[:, 1::2]).max(axis=1), dtype=np.float64)
