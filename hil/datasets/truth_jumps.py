"""Finds jumps of ground truth: rows that no robot can have reached from their neighbours.

A capture system that mistakes another marker for the robot's gives single rows metres away. Such rows jump
away and back, and are dropped. A jump after which the poses stay away is only counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools

Rows = npt.NDArray[np.int_]

_NOISE_M, _NOISE_STEPS = 0.03, 10.0
_TIMES_FASTER = 5.0
_BRIEF_S = 0.5
_GRID_S = 0.1


@dataclass(frozen=True)
class TruthJumps:
    """Jumps of a ground truth.

    Attributes:
        keep: (m,) mask of rows to keep; the others are away for half a second at most.
        lasting: jumps between kept rows, each as time since the first row, s, and distance, m.
    """

    keep: Bools
    lasting: tuple[tuple[float, float], ...]


def fastest_m_s(t_s: Array, angle: Array, radius_m: float) -> float:
    """Largest speed of any wheel over a tenth of a second, m/s.

    Args:
        t_s: (n,) times of the rows, s.
        angle: (n, 4) cumulative wheel angles, rad.
        radius_m: radius of the wheels.
    """
    grid_s = np.arange(t_s[0], t_s[-1], _GRID_S)
    ways = [np.abs(np.diff(np.interp(grid_s, t_s, column))).max(initial=0.0) for column in angle.T]
    return float(max(ways)) * radius_m / _GRID_S


def find_jumps(t_s: Array, pose: Array, speed_m_s: float, lever: float) -> TruthJumps:
    """Find jumps in poses, relative to the longest part without one.

    A step is possible if it is at most five times the way of the fastest wheel meanwhile plus noise: 30 mm,
    or ten typical steps, so that wrong units are not mistaken for jumps.

    Args:
        t_s: (m,) times of the rows, s, increasing.
        pose: (m, 3) ground truth, m, m, rad.
        speed_m_s: speed of the fastest wheel.
        lever: way of a wheel per rad of heading, m.
    """
    rows = np.arange(len(t_s))
    steps_m = _apart_m(pose, rows[:-1], rows[1:], lever)
    noise_m = max(_NOISE_M, _NOISE_STEPS * float(np.median(steps_m)))

    def too_far_m(one: Rows, other: Rows) -> Array:
        reach_m = noise_m + _TIMES_FASTER * speed_m_s * np.abs(t_s[other] - t_s[one])
        apart_m = _apart_m(pose, one, other, lever)
        return np.where(apart_m > reach_m, apart_m, 0.0)

    cuts = np.flatnonzero(too_far_m(rows[:-1], rows[1:])) + 1
    parts = np.split(rows, cuts)
    longest = int(np.argmax([len(part) for part in parts]))
    keep = np.zeros(len(t_s), dtype=bool)
    keep[parts[longest]] = True
    lasting = []
    for side, near, far in ((parts[longest + 1 :], 0, -1), (parts[:longest][::-1], -1, 0)):
        last = parts[longest][far]
        for part in side:
            leap_m = float(too_far_m(last, part[near]))
            if leap_m and t_s[part[-1]] - t_s[part[0]] <= _BRIEF_S:
                continue
            if leap_m:
                lasting.append((float(t_s[max(last, part[near])] - t_s[0]), leap_m))
            keep[part], last = True, part[far]
    return TruthJumps(keep, tuple(sorted(lasting)))


def _apart_m(pose: Array, one: Rows, other: Rows, lever: float) -> Array:
    """Distances between rows of poses, m, with turns at the distance of the wheels."""
    x, y, turn = (pose[other] - pose[one]).T
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.hypot(x, y) + lever * np.abs(turn), dtype=np.float64)
