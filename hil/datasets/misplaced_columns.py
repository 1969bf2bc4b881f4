"""Finds drive and steering columns that are late, or that hold the angles of other wheels.

Each wheel's moves over 0.2 s are compared with those of the ground truth at its place. A change of columns
predicts by how much these moves change. It is named where that is what the moves lack: their regression on
the change is about 1, and most of the difference goes with it. Tolerances of a robot and slip do neither.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.nominal_robot import Nominal
from hil.datasets.sampling import interpolate
from hil.datasets.truth_moves import known_at
from hil.datasets.wheel_displacements import Complexes, by_truth
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import wrong_signs

_GRID_S, _MOVE, _PERIODS = 0.05, 4, 1.5
"""Grid, s; length of a move in its steps, and in periods of slow ground truth."""
_MOST, _STEPS = 40, (4, 2, 1)
"""Largest delay that is tried, and steps of the search, in steps of the grid."""
_OTHER_DRIVE, _OTHER, _TYPICAL = 0.08, 0.15, 90.0
"""A move counts where a change alters it by this share of a typical one (a percentile), beyond tolerances."""
_LACKS_ORDER, _LACKS = 0.05, 0.1
"""Share of a typical move that enough moves of a wheel lack where an exchange, or a delay, is looked for."""
_FEWEST = 20
_SLOPE, _LEFT, _AGAINST = (0.7, 1.3), 0.3, 0.3
"""Regression of what the moves lack on the change, and share of its square that is left with the change."""
_MAYBE, _ENOUGH, _ALIKE = 0.8, 0.5, 0.98
_IN_ORDER, _AT_ONCE, _TOGETHER = (0, 1, 2, 3), (0, 0, 0, 0), (0, 0, 0)
_ORDERS = tuple(itertools.permutations(_IN_ORDER))[1:]
_NOTHING = 1e-12

_BY_ONE = ": stamp all columns by one clock"
_OF_ONE = "its column {}{} comes {{:.2f}} s {{}} than those of the other wheels" + _BY_ONE
_OF_WHEEL = "its columns of the {} wheel (phi, delta) come {{:.2f}} s {{}} than the others'" + _BY_ONE
_OF_PHI = "its wheel angles (phi) come {:.2f} s {} than its steering angles (delta)" + _BY_ONE
_OF_DELTA = "its steering angles (delta) come {:.2f} s {} than its wheel angles (phi)" + _BY_ONE
_OF_TRUTH = (
    ("x of its ground truth comes {:.2f} s {} than its y and theta" + _BY_ONE, (1, 0, 0)),
    ("y of its ground truth comes {:.2f} s {} than its x and theta" + _BY_ONE, (0, 1, 0)),
    ("the heading of its ground truth comes {:.2f} s {} than its positions" + _BY_ONE, (0, 0, 1)),
    ("the positions of its ground truth come {:.2f} s {} than its heading" + _BY_ONE, (1, 1, 0)),
    ("", (1, 1, 1)),
)


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
    phi: Sequence[int] = _IN_ORDER
    delta: Sequence[int] = _IN_ORDER
    phi_late: Sequence[int] = _AT_ONCE
    delta_late: Sequence[int] = _AT_ONCE
    truth_late: Sequence[int] = _TOGETHER

    @property
    def only_drives(self) -> bool:
        """Whether drive angles alone are exchanged: radii are better known than steering zeros."""
        return tuple(self.delta) == _IN_ORDER and not self.late

    @property
    def late(self) -> int:
        """The delay, in steps of the grid; 0 of columns that are exchanged."""
        return max((*self.phi_late, *self.delta_late, *self.truth_late), key=abs)

    def in_words(self) -> str:
        """The cause, with the delay where it is one."""
        return self.cause.format(abs(_GRID_S * self.late), "later" if self.late > 0 else "earlier")


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


def with_misplaced_columns(recordings: Sequence[Recording], nominal: Nominal) -> list[Recording]:
    """The recordings; `contradictions` name columns that are late or of another wheel.

    A cause that explains two recordings, and twice as many as it would spoil, is one of the whole set.
    Wheels of which both columns are exchanged are left to `hil.datasets.odd_wheels`, and what another sign
    explains to `hil.datasets.wrong_signs`.

    Args:
        recordings: recordings to check.
        nominal: robot that they are read for.
    """
    found = [_supports(one) if _comparable(one) else {} for one in recordings]
    if any(map(_best, found)):
        signed = _of_another_sign(recordings, nominal)
        found = [{} if one in signed else own for one, own in enumerate(found)]
    best = [_best(own) for own in found]
    likely = [one.change.cause for one in best if one is not None and one.change.cause]
    common = max(set(likely), key=lambda cause: (likely.count(cause), cause), default="")
    clear = [own[common] for own in found if common in own and own[common].clear]
    against = sum(common in own and own[common].against for own in found)
    if likely and len(clear) >= max(2, 2 * against):
        in_order = sorted(clear, key=lambda support: support.change.late)
        best = [in_order[len(in_order) // 2] if _comparable(one) else None for one in recordings]
    return [
        one if said is None or not said.change.cause else _contradicted(one, said)
        for one, said in zip(recordings, best, strict=True)
    ]


def _comparable(one: Recording) -> bool:
    return one.has_truth and not one.of_twist and not one.contradictions


def _of_another_sign(recordings: Sequence[Recording], nominal: Nominal) -> set[int]:
    """Places of the recordings that a change of a sign, or of the order of whole wheels, explains."""
    places = [k for k, one in enumerate(recordings) if _comparable(one)]
    explained = wrong_signs([recordings[k] for k in places], nominal).explained.values()
    return {k for i, k in enumerate(places) if any(mask[i] for mask in explained)}


def _contradicted(one: Recording, support: Support) -> Recording:
    return replace(one, contradictions=(*one.contradictions, support.change.in_words()))


def _best(found: dict[str, Support]) -> Support | None:
    """The change that explains most of what the moves of a recording lack; None where none is clear.

    One that is corrected or named elsewhere comes first among those that explain as much.
    """
    clear = [one for one in found.values() if one.clear]
    most = max((one.gain for one in clear), default=0.0)
    alike = [one for one in clear if one.gain >= _ALIKE * most]
    return min(alike, key=lambda one: (bool(one.change.cause), -one.gain), default=None)


def _supports(recording: Recording) -> dict[str, Support]:
    """How each change agrees with a recording, by cause; of delays the one that explains most."""
    out = _judged(_Moves.of(recording, 0.0))
    best = _best(out)
    if best is not None and not best.change.cause and best.change.late:
        return _judged(_Moves.of(recording, _GRID_S * best.change.late))
    return out


def _judged(moves: "_Moves | None") -> dict[str, Support]:
    """How each change agrees with moves, by cause; delays that agree at all are then searched finely."""
    out = dict[str, Support]()
    if moves is None:
        return out

    def judge(changes: Iterable[Change]) -> None:
        for one in map(moves.support, changes):
            if one.change.cause not in out or one.gain > out[one.change.cause].gain:
                out[one.change.cause] = one

    out["turned"] = moves.turned()
    judge(_exchanges() if len(moves.lacking(_LACKS_ORDER)) > 1 else ())
    wheels = moves.lacking(_LACKS)
    judge(change for late in range(-_MOST, _MOST + 1, _STEPS[0]) for change in _delays(wheels, late))
    for step in _STEPS[1:]:
        near = {
            (cause, late)
            for cause, one in out.items()
            if one.change.late and one.left < _MAYBE
            for late in (one.change.late - step, one.change.late + step)
            if abs(late) <= _MOST
        }
        judge(change for c, late in sorted(near) for change in _delays(wheels, late) if change.cause == c)
    return out


def _exchanges() -> Iterator[Change]:
    """All other orders of columns."""
    for order in _ORDERS:
        yield Change(_exchanged("phi", order), phi=order)
        yield Change(_exchanged("delta", order), delta=order)
        yield Change("", phi=order, delta=order)


def _delays(wheels: Sequence[int], late: int) -> Iterator[Change]:
    """Delays, of so many steps of the grid, that may explain what the moves of these wheels lack."""
    for i in wheels if late else ():
        own = [late * (k == i) for k in _IN_ORDER]
        yield Change(_OF_ONE.format("phi", i + 1), phi_late=own)
        yield Change(_OF_ONE.format("delta", i + 1), delta_late=own)
        yield Change(_OF_WHEEL.format(WHEELS[i]), phi_late=own, delta_late=own)
    if late and len(wheels) > 1:
        yield Change(_OF_PHI, phi_late=[late] * 4)
        yield Change(_OF_DELTA, delta_late=[late] * 4)
        for cause, columns in _OF_TRUTH:
            yield Change(cause, truth_late=[late * column for column in columns])


def _exchanged(name: str, order: Sequence[int]) -> str:
    """What is wrong where each wheel has to take the columns of `order`."""
    moved = [i for i in _IN_ORDER if order[i] != i]
    if len(moved) == 2:
        one, other = moved
        return (
            f"its columns {name}{one + 1} and {name}{other + 1} are exchanged: they hold the angles of "
            f"{WHEELS[other]} and {WHEELS[one]}"
        )
    held = ", ".join(WHEELS[tuple(order).index(i)] for i in _IN_ORDER)
    return f"its columns {name}1 to {name}4 hold the angles of {held}"


class _Moves:
    """Moves (k, 4) of the wheels of a recording, by ground truth and by columns, in the frame of the body."""

    def __init__(self, recording: Recording, late_s: float, begin_s: float, end_s: float) -> None:
        self._wheels = wheels = recording.nominal.geometry
        t_s, truth_t_s = recording.t_s, recording.truth_t_s - late_s
        self._length = _length(truth_t_s)
        self._count = int((end_s - begin_s) / _GRID_S)
        grid_s: Array = begin_s + _GRID_S * np.arange(-_MOST, self._count + 1 + _MOST, dtype=np.float64)
        self._phi = interpolate(grid_s, t_s, recording.wheel_angle_rad * wheels.radius_m.mean())
        self._delta = interpolate(grid_s, t_s, recording.steering_rad)
        self._radii, self._zero_rad = wheels.radius_m / wheels.radius_m.mean(), wheels.steering_zero_rad
        self._pose = interpolate(grid_s, truth_t_s, recording.truth_pose)
        self._edges_s: Array = grid_s[_MOST : _MOST + self._count + 1]
        self._moved = self._by_truth(_TOGETHER)
        known = known_at(self._edges_s, truth_t_s)
        self._known = known[self._length :] & known[: -self._length]
        self._rolled = np.column_stack([self._of(k, k, k, 0, 0) for k in _IN_ORDER])
        self._lack = np.where(self._known[:, None], self._moved - self._rolled, 0.0)
        size = np.maximum(np.abs(self._moved), np.abs(self._rolled)).max(axis=1)
        self._typical_m = float(np.percentile(size, _TYPICAL))

    @classmethod
    def of(cls, recording: Recording, late_s: float) -> "_Moves | None":
        """Moves in the time that both cover, of ground truth that is so late; None where it is too short."""
        begin_s = max(recording.t_s[0], recording.truth_t_s[0] - late_s)
        end_s = min(recording.t_s[-1], recording.truth_t_s[-1] - late_s)
        if end_s - begin_s < 2.0 * _GRID_S * max(_FEWEST, _length(recording.truth_t_s)):
            return None
        made = cls(recording, late_s, begin_s, end_s)
        return made if made._typical_m > _NOTHING else None

    def lacking(self, share: float) -> list[int]:
        """Wheels of which enough moves lack this share of a typical one that a change may explain it."""
        many = np.count_nonzero(np.abs(self._lack) > share * self._typical_m, axis=0)
        return [int(i) for i in np.flatnonzero(many >= _ENOUGH * _FEWEST)]

    def support(self, change: Change) -> Support:
        """How a change of columns agrees with what the moves lack."""
        altered, by = list(_IN_ORDER), self._moved
        if any(change.truth_late):
            by = self._moved - self._by_truth(change.truth_late)
        else:
            altered = [k for k in _IN_ORDER if any(own[k] != same[k] for own, same in _pairs(change))]
            columns = zip(change.phi, change.delta, change.phi_late, change.delta_late, strict=True)
            new = [self._of(k, *own) for k, own in enumerate(columns) if k in altered]
            by = np.column_stack(new) - self._rolled[:, altered]
        return self._support(change, by, altered)

    def turned(self) -> Support:
        """The same of ground truth whose body has another heading, which is corrected or named elsewhere."""
        angle = np.angle(np.sum(np.conj(self._moved[self._known]) * self._rolled[self._known]))
        return self._support(Change(""), self._moved * (1.0 - np.exp(1j * angle)), _IN_ORDER)

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
        first, second = _MOST + phi_late, _MOST + delta_late
        steps_m = np.diff(self._phi[first : first + self._count + 1, phi]) * self._radii[wheel]
        angle = self._delta[second : second + self._count + 1, delta]
        heading = 0.5 * (angle[1:] + angle[:-1]) - self._zero_rad[wheel]
        return self._over(steps_m * np.exp(1j * heading))

    def _by_truth(self, late: Sequence[int]) -> Complexes:
        """Moves (k, 4), m, by ground truth whose x, y and theta were stamped so many steps earlier."""
        columns = [self._pose[_MOST + own : _MOST + own + self._count + 1, j] for j, own in enumerate(late)]
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
    return max(_MOVE, int(np.ceil(_PERIODS * float(np.median(np.diff(truth_t_s))) / _GRID_S)))


def _pairs(change: Change) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    yield change.phi, _IN_ORDER
    yield change.delta, _IN_ORDER
    yield change.phi_late, _AT_ONCE
    yield change.delta_late, _AT_ONCE
