"""Finds jumps of ground truth: rows that no robot can have reached from their neighbours.

A capture system that mistakes a marker for another one gives single rows metres away, or a heading that steps
by some hundredths of a radian and stays there. Position and heading have a bound each. Rows that jump away
and back are dropped, and so are rows beyond a jump in which the robot rests. Any other jump is reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools
from hil.datasets.nominal_robot import Nominal
from hil.robot.kinematics import forward

Rows = npt.NDArray[np.int_]

_NOISE_M, _NOISE_RAD, _NOISE_STEPS = 0.005, 0.02, 10.0
_TIMES_FASTER, _TURNS_MORE = 5.0, 1.5
_BRIEF_S = 0.5
_GRID_S = 0.1
_BESIDE = 5
_SMEARED_ROWS, _SMEARED_RAD, _SMEARED_S = 8, 0.03, 0.5
_RESTS_RAD = 0.02


@dataclass(frozen=True)
class WheelMotion:
    """Motion of the nominal robot by its wheels, as far as it bounds the ground truth.

    Attributes:
        t_s: (n,) times of the rows, s.
        angle: (n, 4) cumulative wheel angles, rad.
        heading: (n,) heading by nominal odometry from 0, rad.
        turned: (n,) largest turn since the first row that a late clock and wrong radii allow for, rad.
        speed_m_s: largest speed of any wheel over a tenth of a second.
        turn_rad_s: largest slope of `turned`, which goes on where there are no wheel rows.
    """

    t_s: Array
    angle: Array
    heading: Array
    turned: Array
    speed_m_s: float
    turn_rad_s: float

    @classmethod
    def of(cls, t_s: Array, angle: Array, steering: Array, nominal: Nominal) -> WheelMotion:
        """Motion of wheel rows: times (n,), s, wheel and steering angles (n, 4), rad."""
        wheels, middle = nominal.geometry, 0.5 * (steering[1:] + steering[:-1])
        turns = forward(wheels, np.diff(angle, axis=0) * wheels.radius_m, middle)[:, 2]
        heading = np.concatenate([[0.0], np.cumsum(turns)])
        grid_s = np.arange(t_s[0], t_s[-1] + 2.0 * _GRID_S, _GRID_S)
        ways = [np.abs(np.diff(np.interp(grid_s, t_s, column))).max(initial=0.0) for column in angle.T]
        turn = np.pad(np.abs(np.diff(np.interp(grid_s, t_s, heading))), _BESIDE)
        most = np.lib.stride_tricks.sliding_window_view(turn, 2 * _BESIDE + 1).max(axis=1)
        turned = _TURNS_MORE * np.concatenate([[0.0], np.cumsum(most)])
        speed_m_s = float(max(ways)) * nominal.radius_m / _GRID_S
        fastest_rad_s = _TURNS_MORE * float(most.max(initial=0.0)) / _GRID_S
        return cls(t_s, angle, heading, np.interp(t_s, grid_s, turned), speed_m_s, fastest_rad_s)

    def rests(self, begin_s: float, end_s: float) -> bool:
        """Whether no wheel turns between two instants."""
        inside = (self.t_s >= begin_s) & (self.t_s <= end_s)
        return not inside.any() or float(np.ptp(self.angle[inside], axis=0).max()) < _RESTS_RAD


@dataclass(frozen=True)
class Jump:
    """A jump after which the poses stay away: time since the first row, s, distance, m, and turn, rad."""

    at_s: float
    way_m: float
    turn_rad: float

    def in_words(self) -> str:
        """The jump as part of a sentence."""
        sizes = [f"{self.way_m:.2g} m"] if self.way_m else []
        sizes += [f"{self.turn_rad:.2g} rad"] if self.turn_rad else []
        when = f"{self.at_s:.1f} s after its begin"
        return f"its ground truth steps by {' and '.join(sizes)} {when} and stays there"


@dataclass(frozen=True)
class TruthJumps:
    """Jumps of a ground truth.

    Attributes:
        keep: (m,) mask of rows to keep.
        resting: number of dropped rows that are beyond a jump for more than half a second, at rest.
        lasting: jumps between kept rows, in order.
    """

    keep: Bools
    resting: int
    lasting: tuple[Jump, ...]


def find_jumps(t_s: Array, pose: Array, wheels: WheelMotion) -> TruthJumps:
    """Find jumps in poses, relative to the longest part without one.

    A step of the position is possible if it is at most five times the way of the fastest wheel meanwhile
    and 5 mm. A step of the heading is possible if it, or its difference to the wheels' turn, is at most one
    and a half times what the wheels turn at that time (half a second earlier or later) and 0.02 rad. Both
    bounds are ten typical steps at least, so that noise and wrong units are not mistaken for jumps.

    Args:
        t_s: (m,) times of the rows, s, increasing.
        pose: (m, 3) ground truth, m, m, rad.
        wheels: motion by the wheels.
    """
    steps = _Steps(t_s, pose, wheels)
    rows = np.arange(len(t_s))
    parts = np.split(rows, np.flatnonzero(steps.too_far(rows[:-1], rows[1:])) + 1)
    longest = int(np.argmax([len(part) for part in parts]))
    keep = np.zeros(len(t_s), dtype=bool)
    keep[parts[longest]] = True
    resting, lasting = 0, list[Jump]()
    for side, near, far in ((parts[longest + 1 :], 0, -1), (parts[:longest][::-1], -1, 0)):
        last = parts[longest][far]
        for part in side:
            if steps.too_far(last, part[near]):
                begin_s, end_s = t_s[part[0]], t_s[part[-1]]
                if end_s - begin_s <= _BRIEF_S:
                    continue
                if wheels.rests(begin_s, end_s):
                    resting += len(part)
                    continue
                lasting.append(steps.jump(last, part[near]))
            keep[part], last = True, part[far]
    lasting = lasting or steps.smeared(np.flatnonzero(keep))
    return TruthJumps(keep, resting, tuple(sorted(lasting, key=lambda jump: jump.at_s)))


class _Steps:
    """Steps between rows of ground truth, and their bounds; see `find_jumps`."""

    def __init__(self, t_s: Array, pose: Array, wheels: WheelMotion) -> None:
        self._t_s, self._pose, self._speed_m_s = t_s, pose, wheels.speed_m_s
        self._by_wheels = np.interp(t_s, wheels.t_s, wheels.heading)
        unseen_s = np.minimum(t_s - wheels.t_s[0], 0.0) + np.maximum(t_s - wheels.t_s[-1], 0.0)
        self._turned = np.interp(t_s, wheels.t_s, wheels.turned) + wheels.turn_rad_s * unseen_s
        rows = np.arange(len(t_s))
        way_m, turn_rad = self._between(rows[:-1], rows[1:])
        self._noise_m = max(_NOISE_M, _NOISE_STEPS * float(np.median(way_m)))
        self._noise_rad = max(_NOISE_RAD, _NOISE_STEPS * float(np.median(turn_rad)))

    def _between(self, one: Rows, other: Rows) -> tuple[Array, Array]:
        """Distances, m, and turns that neither truth nor wheels explain, rad, between rows."""
        x, y, turn = (self._pose[other] - self._pose[one]).T
        unlike = turn - (self._by_wheels[other] - self._by_wheels[one])
        return np.hypot(x, y), np.minimum(np.abs(_wrapped(turn)), np.abs(_wrapped(unlike)))

    def _excess(self, one: Rows, other: Rows) -> tuple[Array, Array]:
        """Distances and turns between rows; 0 where they are possible."""
        way_m, turn_rad = self._between(one, other)
        reach_m = self._noise_m + _TIMES_FASTER * self._speed_m_s * np.abs(self._t_s[other] - self._t_s[one])
        reach_rad = self._noise_rad + np.abs(self._turned[other] - self._turned[one])
        return np.where(way_m > reach_m, way_m, 0.0), np.where(turn_rad > reach_rad, turn_rad, 0.0)

    def too_far(self, one: Rows, other: Rows) -> Bools:
        """Whether no robot goes from one row to the other."""
        way_m, turn_rad = self._excess(one, other)
        return np.asarray((way_m > 0.0) | (turn_rad > 0.0), dtype=np.bool_)

    def jump(self, one: Rows, other: Rows) -> Jump:
        """The jump between two rows."""
        way_m, turn_rad = self._excess(one, other)
        at_s = max(self._t_s[one], self._t_s[other]) - self._t_s[0]
        return Jump(float(at_s), float(way_m), float(turn_rad))

    def smeared(self, rows: Rows) -> list[Jump]:
        """Steps of the heading that a filter spread over some rows, or that noise hides from row to row."""
        n = _SMEARED_ROWS
        if len(rows) < 4 * n:
            return []
        heading = np.unwrap(self._pose[rows, 2])
        unlike = heading - self._by_wheels[rows]
        view = np.lib.stride_tricks.sliding_window_view
        steps = [np.median(view(h, n), axis=1) for h in (heading, unlike)]
        turn = np.min([np.abs(median[2 * n :] - median[: -2 * n]) for median in steps], axis=0)
        first, last = rows[: len(turn)], rows[3 * n - 1 :]
        reach = self._turned[last] - self._turned[first]
        noise = max(_SMEARED_RAD, _NOISE_STEPS * float(np.median(turn)))
        found = np.flatnonzero((turn > noise + reach) & (self._t_s[last] - self._t_s[first] < _SMEARED_S))
        out = list[Jump]()
        for group in np.split(found, np.flatnonzero(np.diff(found) > n) + 1) if len(found) else ():
            best = int(group[np.argmax(turn[group])])
            at_s = self._t_s[rows[best + 3 * n // 2]] - self._t_s[0]
            out.append(Jump(float(at_s), 0.0, float(turn[best])))
        return out


def _wrapped(turn: Array) -> Array:
    """Turns within half a turn to either side, rad."""
    return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)
