"""Paths and time laws: the segments of a trajectory, evaluated at one time or at many times at once.

A segment is a path over s in [0, 1] and a time law: `quintic` (s = 10 u^3 - 15 u^4 + 6 u^5, at rest at both
ends) or `constant` (the step profile of the public recordings). SI units.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, rotation2

TimeLaw = Literal["quintic", "constant"]
Pose = tuple[float, float, float]
Ints = npt.NDArray[np.int64]
_Number = TypeVar("_Number", float, Array)

_STRAIGHT_ON: Pose = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Straight:
    """Straight path: x, y and heading linear in s between two poses (x m, y m, theta rad)."""

    start: Pose
    end: Pose

    def __call__(self, s: float) -> tuple[Pose, Pose, Pose]:
        """Pose at s, and its first and second derivatives by s."""
        (x, y, theta), (dx, dy, turn) = self.start, self._way
        return (x + s * dx, y + s * dy, theta + s * turn), self._way, _STRAIGHT_ON

    @cached_property
    def _way(self) -> Pose:
        """Difference between the last and the first pose."""
        (x, y, theta), (to_x, to_y, to_theta) = self.start, self.end
        return (to_x - x, to_y - y, to_theta - theta)


@dataclass(frozen=True)
class Arc:
    """Arc to the left (positive angle) or right of the start heading, heading tangent or fixed."""

    start: Pose
    radius_m: float
    angle_rad: float
    tangent: bool = True

    def __call__(self, s: float) -> tuple[Pose, Pose, Pose]:
        """Pose at s, and its first and second derivatives by s."""
        x, y, theta = self.start
        side, w = math.copysign(1.0, self.angle_rad), abs(self.angle_rad)
        a = w * s
        sin, cos, turn = math.sin(a), math.cos(a), self._turn
        px, py = turn.dot((sin, side * (1.0 - cos))).tolist()
        dx, dy = turn.dot((cos, side * sin)).tolist()
        ddx, ddy = turn.dot((-sin, side * cos)).tolist()
        heading, rate = (side * a, side * w) if self.tangent else (0.0, 0.0)
        return (x + px, y + py, theta + heading), (dx * w, dy * w, rate), (ddx * w**2, ddy * w**2, 0.0)

    @cached_property
    def _turn(self) -> Array:
        """Matrix (2, 2) from axes of the start heading to wall axes, times the radius."""
        return rotation2(self.start[2]) * self.radius_m


@dataclass(frozen=True)
class Segment:
    """A path over s in [0, 1], its duration, and its time law."""

    path: Straight | Arc
    duration_s: float
    law: TimeLaw = "quintic"

    def at(self, t_s: float) -> tuple[Pose, Pose, Pose]:
        """Pose, velocity and acceleration in wall axes at a time within the segment."""
        u = t_s / self.duration_s
        u = 0.0 if u < 0.0 else 1.0 if u > 1.0 else u
        if self.law == "quintic":
            s, ds, dds = _quintic(u, self.duration_s)
        else:
            s, ds, dds = u, (1.0 / self.duration_s if 0.0 <= t_s < self.duration_s else 0.0), 0.0
        pose, (ax, ay, turn), (bx, by, bend) = self.path(s)
        squared = ds**2
        pull = (bx * squared + ax * dds, by * squared + ay * dds, bend * squared + turn * dds)
        return pose, (ax * ds, ay * ds, turn * ds), pull


def _quintic(u: _Number, duration_s: _Number) -> tuple[_Number, _Number, _Number]:
    """Quintic time law: s and its first two time derivatives at fraction u of the duration."""
    s = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    ds = 30.0 * u**2 * (1.0 - u) ** 2 / duration_s
    return s, ds, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration_s**2


class Chain:
    """Consecutive segments as arrays, to evaluate `Segment.at` at many times at once.

    Attributes:
        durations_s: (m,) durations of the segments.
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        self.durations_s = np.array([part.duration_s for part in segments], dtype=np.float64)
        self._constant = np.array([part.law == "constant" for part in segments])
        self._bent = np.array([isinstance(part.path, Arc) for part in segments])
        self._row = np.where(self._bent, np.cumsum(self._bent), np.cumsum(~self._bent)) - 1
        paths = [part.path for part in segments]
        straights = [(path.start, path.end) for path in paths if isinstance(path, Straight)]
        arcs = [(*p.start, p.radius_m, p.angle_rad, p.tangent) for p in paths if isinstance(p, Arc)]
        self._straights = np.array(straights, dtype=np.float64).reshape(-1, 2, 3)
        self._arcs = np.array(arcs, dtype=np.float64).reshape(-1, 6)

    def at(self, k: Ints, t_s: Array) -> tuple[Array, Array, Array]:
        """Pose, velocity and acceleration in wall axes, (n, 3) each.

        Args:
            k: (n,) index of the segment; the number of segments stands for the rest after the last one.
            t_s: (n,) time within the segment, not negative.
        """
        over = k == len(self.durations_s)
        k = np.where(over, k - 1, k)
        duration_s = np.where(over, 1.0, self.durations_s[k])
        u = np.where(over, 1.0, np.minimum(t_s / duration_s, 1.0))
        evenly = u, np.where(over | (t_s >= duration_s), 0.0, 1.0 / duration_s), np.zeros(len(u))
        laws = zip(evenly, _quintic(u, duration_s), strict=True)
        s, ds, dds = (np.where(self._constant[k], a, b)[:, None] for a, b in laws)
        pose, first, second = self._along(k, s)
        return pose, first * ds, second * ds**2 + first * dds

    def _along(self, k: Ints, s: Array) -> tuple[Array, Array, Array]:
        """Poses (n, 3) on the paths k at s (n, 1), and their first and second derivatives by s."""
        pose, first, second = np.zeros((3, len(k), 3))
        bent, row = self._bent[k], self._row[k]
        start, end = self._straights[row[~bent]].transpose(1, 0, 2)
        first[~bent] = end - start
        pose[~bent] = start + s[~bent] * first[~bent]
        if bent.any():
            pose[bent], first[bent], second[bent] = _along_arcs(self._arcs[row[bent]], s[bent])
        return pose, first, second


def _along_arcs(arcs: Array, s: Array) -> tuple[Array, Array, Array]:
    """`Arc` for many rows (n, 6) of x, y, theta, radius, angle, tangent, at s (n, 1); (n, 3) each."""
    _, _, theta, radius_m, angle_rad, tangent = arcs.T
    side, w = np.copysign(1.0, angle_rad), np.abs(angle_rad)
    turn, c, d = tangent * side, radius_m * np.cos(theta), radius_m * np.sin(theta)
    a = w * s[:, 0]
    sin, cos = np.sin(a), np.cos(a)

    def turned(ahead: Array, left: Array, heading: Array) -> Array:
        return np.column_stack([c * ahead - d * left, d * ahead + c * left, heading])

    pose = arcs[:, :3] + turned(sin, side * (1.0 - cos), turn * a)
    first = turned(cos, side * sin, turn) * w[:, None]
    return pose, first, turned(-sin, side * cos, np.zeros(len(a))) * w[:, None] ** 2
