"""Moves of the wheels of a recording, and how a change of its columns agrees with what they lack.

A move is the way of a wheel over 0.2 s, by ground truth at its place and by its columns. A change of columns
predicts by how much the latter change.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.core.geometry import Array
from hil.datasets.sampling import interpolate
from hil.datasets.truth_moves import known_at
from hil.datasets.wheel_displacements import Complexes, by_truth
from hil.datasets.wheel_log import Recording

GRID_S, _MOVE, _PERIODS = 0.05, 4, 1.5
"""Grid, s; length of a move in its steps, and in periods of slow ground truth."""
MOST = 40
"""Largest delay that is tried, in steps of the grid."""
_OTHER_DRIVE, _OTHER, _TYPICAL = 0.08, 0.15, 90.0
"""A move counts where a change alters it by this share of a typical one (a percentile), beyond tolerances."""
_FEWEST, _ENOUGH = 20, 0.5
_SLOPE, _LEFT, _AGAINST = (0.7, 1.3), 0.3, 0.3
"""Regression of what the moves lack on the change, and share of its square that is left with the change."""
IN_ORDER, _AT_ONCE, _TOGETHER = (0, 1, 2, 3), (0, 0, 0, 0), (0, 0, 0)
_NOTHING = 1e-12


class Change(NamedTuple):
    """The columns that each wheel would take, and how many steps of the grid later columns were stamped.

    Attributes:
        cause: name of the cause, the same for all delays; empty where another module corrects or names it.
        phi: columns of the drive angles.
        delta: columns of the steering angles.
        phi_late: delays of the drive angles.
        delta_late: delays of the steering angles.
        truth_late: delays of x, y and theta.
    """

    cause: str
    phi: Sequence[int] = IN_ORDER
    delta: Sequence[int] = IN_ORDER
    phi_late: Sequence[int] = _AT_ONCE
    delta_late: Sequence[int] = _AT_ONCE
    truth_late: Sequence[int] = _TOGETHER

    @property
    def only_drives(self) -> bool:
        """Whether drive angles alone are exchanged: radii are better known than steering zeros."""
        return tuple(self.delta) == IN_ORDER and not self.late

    @property
    def late(self) -> int:
        """The delay, in steps of the grid; 0 of columns that are exchanged."""
        return max((*self.phi_late, *self.delta_late, *self.truth_late), key=abs)

    def in_words(self) -> str:
        """The cause, with the delay where it is one."""
        return self.cause.format(abs(GRID_S * self.late), "later" if self.late > 0 else "earlier")


@dataclass(frozen=True)
class Support:
    """How a change of columns agrees with what the moves of a recording lack.

    Attributes:
        change: the change.
        count: number of moves that it alters.
        slope: regression of what these lack on the change.
        left: share of the square of what they lack that is left with the change.
        gain: square of what all moves lack, less what is left, m^2.
    """

    change: Change
    count: int
    slope: float
    left: float
    gain: float

    @property
    def clear(self) -> bool:
        """Whether the change explains these moves."""
        return self.count >= _FEWEST and _SLOPE[0] < self.slope < _SLOPE[1] and self.left < _LEFT

    @property
    def against(self) -> bool:
        """Whether the moves say that the columns are right as they are."""
        return self.count >= _FEWEST and self.slope < _AGAINST


class Moves:
    """Moves (k, 4) of the wheels of a recording, by ground truth and by columns, in the frame of the body."""

    def __init__(self, recording: Recording, late_s: float, begin_s: float, end_s: float) -> None:
        self._wheels = wheels = recording.nominal.geometry
        t_s, truth_t_s = recording.t_s, recording.truth_t_s - late_s
        self._length = _length(truth_t_s)
        self._count = int((end_s - begin_s) / GRID_S)
        grid_s: Array = begin_s + GRID_S * np.arange(-MOST, self._count + 1 + MOST, dtype=np.float64)
        self._phi = interpolate(grid_s, t_s, recording.wheel_angle_rad * wheels.radius_m.mean())
        self._delta = interpolate(grid_s, t_s, recording.steering_rad)
        self._radii, self._zero_rad = wheels.radius_m / wheels.radius_m.mean(), wheels.steering_zero_rad
        self._pose = interpolate(grid_s, truth_t_s, recording.truth_pose)
        self._edges_s: Array = grid_s[MOST : MOST + self._count + 1]
        self._moved = self._by_truth(_TOGETHER)
        known = known_at(self._edges_s, truth_t_s)
        self._known = known[self._length :] & known[: -self._length]
        self._rolled = np.column_stack([self._of(k, k, k, 0, 0) for k in IN_ORDER])
        self._lack = np.where(self._known[:, None], self._moved - self._rolled, 0.0)
        size = np.maximum(np.abs(self._moved), np.abs(self._rolled)).max(axis=1)
        self._typical_m = float(np.percentile(size, _TYPICAL))

    @classmethod
    def of(cls, recording: Recording, late_s: float) -> "Moves | None":
        """Moves in the time that both cover, of ground truth that is so late; None where it is too short."""
        begin_s = max(recording.t_s[0], recording.truth_t_s[0] - late_s)
        end_s = min(recording.t_s[-1], recording.truth_t_s[-1] - late_s)
        if end_s - begin_s < 2.0 * GRID_S * max(_FEWEST, _length(recording.truth_t_s)):
            return None
        made = cls(recording, late_s, begin_s, end_s)
        return made if made._typical_m > _NOTHING else None

    def lacking(self, share: float) -> list[int]:
        """Wheels of which enough moves lack this share of a typical one that a change may explain it."""
        many = np.count_nonzero(np.abs(self._lack) > share * self._typical_m, axis=0)
        return [int(i) for i in np.flatnonzero(many >= _ENOUGH * _FEWEST)]

    def support(self, change: Change) -> Support:
        """How a change of columns agrees with what the moves lack."""
        altered, by = list(IN_ORDER), self._moved
        if any(change.truth_late):
            by = self._moved - self._by_truth(change.truth_late)
        else:
            altered = [k for k in IN_ORDER if any(own[k] != same[k] for own, same in _pairs(change))]
            columns = zip(change.phi, change.delta, change.phi_late, change.delta_late, strict=True)
            new = [self._of(k, *own) for k, own in enumerate(columns) if k in altered]
            by = np.column_stack(new) - self._rolled[:, altered]
        return self._support(change, by, altered)

    def turned(self) -> Support:
        """The same of ground truth whose body has another heading, which is corrected or named elsewhere."""
        angle = np.angle(np.sum(np.conj(self._moved[self._known]) * self._rolled[self._known]))
        return self._support(Change(""), self._moved * (1.0 - np.exp(1j * angle)), IN_ORDER)

    def _support(self, change: Change, by: Complexes, altered: Sequence[int]) -> Support:
        """How changes `by` (k, a) of the moves of wheels `altered` (a) agree with what these lack."""
        lack = self._lack[:, list(altered)]
        least = _OTHER_DRIVE if change.only_drives else _OTHER
        counts = (np.abs(by) > least * self._typical_m) & self._known[:, None]
        along, size = _products(by[counts], lack[counts])
        left = float(np.sum(np.abs(lack[counts] - by[counts]) ** 2))
        left /= max(float(np.sum(np.abs(lack[counts]) ** 2)), _NOTHING)
        whole, own = _products(by[self._known], lack[self._known])
        count = int(counts.any(axis=1).sum())
        return Support(change, count, along / max(size, _NOTHING), left, 2.0 * whole - own)

    def _of(self, wheel: int, phi: int, delta: int, phi_late: int, delta_late: int) -> Complexes:
        """Moves (k,), m, of a wheel that takes these columns, stamped so many steps of the grid earlier."""
        first, second = MOST + phi_late, MOST + delta_late
        steps_m = np.diff(self._phi[first : first + self._count + 1, phi]) * self._radii[wheel]
        angle = self._delta[second : second + self._count + 1, delta]
        heading = 0.5 * (angle[1:] + angle[:-1]) - self._zero_rad[wheel]
        return self._over(steps_m * np.exp(1j * heading))

    def _by_truth(self, late: Sequence[int]) -> Complexes:
        """Moves (k, 4), m, by ground truth whose x, y and theta were stamped so many steps earlier."""
        columns = [self._pose[MOST + own : MOST + own + self._count + 1, j] for j, own in enumerate(late)]
        return self._over(by_truth(self._edges_s, np.column_stack(columns), self._edges_s, self._wheels))

    def _over(self, steps: Complexes) -> Complexes:
        """Sums over the length of a move of steps (n,) or (n, 4)."""
        sums = np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
        return np.asarray(sums[self._length :] - sums[: -self._length])


def _products(by: Complexes, lack: Complexes) -> tuple[float, float]:
    """Products of changes with what is lacking, and with themselves, as sums over vectors."""
    return float(np.sum((np.conj(by) * lack).real)), float(np.sum(np.abs(by) ** 2))


def _length(truth_t_s: Array) -> int:
    """Length of a move in steps of the grid: more than a period of the ground truth."""
    return max(_MOVE, int(np.ceil(_PERIODS * float(np.median(np.diff(truth_t_s))) / GRID_S)))


def _pairs(change: Change) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    yield change.phi, IN_ORDER
    yield change.delta, IN_ORDER
    yield change.phi_late, _AT_ONCE
    yield change.delta_late, _AT_ONCE
