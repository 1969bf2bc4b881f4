"""Unwraps wheel angles: distinguishes wrapped counters from gaps, restarts and unknown turns.

An angle that leaps by a whole number of turns, from one edge of what its column holds to the other, wrapped.
One that a wheel can have rolled since the row before is left as it is, however long that was. Where a counter
wraps at every turn, rows that are further apart than half a turn takes do not say how often the wheel turned;
its rates may. Nothing else is guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.truth_jumps import Bools

WRAPS = "wheel-angle wrap-arounds undone"
BY_RATES = "wheel angles behind a gap given their turns by the wheel rates"

_TURN = 2.0 * np.pi
_LITTLE_RAD = 0.1
_FASTEST_RAD_S, _FASTER = 5.0, 1.25
_FEWEST_LEFT_OUT, _LEFT_OUT = 2, 0.02
"""Of the fastest steps, which leaps may be: so many at least, and such a share."""
_GRID_S = 0.1
_UNMOVED_RAD = 0.02
_SAME_RAD = 1e-6
_ALIKE_RAD = 0.25 * _TURN


@dataclass(frozen=True)
class Turns:
    """Wheel angles with their whole turns.

    Attributes:
        angle: (n, 4) cumulative, rad; what was refused is left in it.
        repairs: what was repaired, by name and count.
        refusal: the first leap that is no wrap, or gap with unknown turns.
    """

    angle: Array
    repairs: Mapping[str, int]
    refusal: DataError | None


@dataclass(frozen=True)
class _Steps:
    """From row to row.

    Attributes:
        lasts_s: (n - 1,) time between them, s.
        moved: (n - 1, 4) what the angles do, rad.
        reach: (n - 1,) how far a wheel gets, rad.
        near: (n - 1,) the same with something for stamps that jitter; what is closer is the same place.
        by_rate: (n - 1, 4) what the wheel rates make of it, rad, NaN where there are none.
        off: (n - 1, 4) by how much that is wrong at most where the rate only rose or only fell, rad.
    """

    lasts_s: Array
    moved: Array
    reach: Array
    near: Array
    by_rate: Array
    off: Array


def whole_turns(where: str, t_s: Array, angle: Array, rate: Array) -> Turns:
    """Undo what is a wrap in wheel angles, and find what is none.

    How far a wheel can get between two rows follows from the fastest one of the recording, with a quarter to
    spare, and at least 5 rad/s. A step of half a turn or less is always left alone within that reach.

    Args:
        where: the file, for messages.
        t_s: (n,) times of the rows, s, increasing.
        angle: (n, 4) as they stand in the file, rad.
        rate: (n, 4) wheel rates, rad/s, NaN where there are none.
    """
    steps = _steps(t_s, angle, rate)
    size = np.abs(steps.moved)
    far = size > np.maximum(np.pi, steps.reach)[:, None]
    one_turn = np.ptp(angle, axis=0) <= _TURN + _LITTLE_RAD
    turns, wraps = _wrapped(angle, steps, far)
    unsure = (steps.reach >= np.pi)[:, None] & one_turn & np.any(wraps[:, one_turn])
    unsure &= np.any((size > _UNMOVED_RAD) | np.isfinite(steps.by_rate), axis=1, keepdims=True)
    reported, agrees = _by_rates(steps)
    by_rate = unsure & agrees
    wraps &= ~unsure
    turns = np.where(by_rate, reported, np.where(wraps, turns, 0.0))
    restarts = np.any(size > np.minimum(steps.near, np.pi)[:, None], axis=1) & _as_at_first(angle)
    leaps = ((far & ~wraps) | restarts[:, None]) & ~unsure
    counts = {WRAPS: np.count_nonzero(wraps), BY_RATES: np.count_nonzero(by_rate)}
    return Turns(
        _with_turns(angle, turns),
        {what: int(number) for what, number in counts.items() if number},
        _refusal(where, t_s, steps, leaps, unsure & ~by_rate),
    )


def _steps(t_s: Array, angle: Array, rate: Array) -> _Steps:
    lasts_s, moved = np.diff(t_s), np.diff(angle, axis=0)
    fastest = max(_FASTEST_RAD_S, _FASTER * _fastest_rad_s(t_s, angle))
    half_s = 0.5 * lasts_s[:, None]
    reach = fastest * lasts_s
    near = np.maximum(reach, np.median(reach)) + _LITTLE_RAD
    by_rate, off = (rate[1:] + rate[:-1]) * half_s, np.abs(np.diff(rate, axis=0)) * half_s
    return _Steps(lasts_s, moved, reach, near, by_rate, off)


def _fastest_rad_s(t_s: Array, angle: Array) -> float:
    """Speed of the fastest wheel in a tenth of a second, rad/s; wraps do not count."""
    ways = []
    grid_s = np.arange(t_s[0], t_s[-1], _GRID_S)
    for column in angle.T:
        rolled = column if np.ptp(column) > _TURN + _LITTLE_RAD else np.unwrap(column)
        ways.append(np.sort(np.abs(np.diff(np.interp(grid_s, t_s, rolled)))))
    return max(map(_without_jumps, ways)) / _GRID_S


def _without_jumps(ways: Array) -> float:
    """The largest of some (n,) in order, without those that leaps may be."""
    left_out = max(_FEWEST_LEFT_OUT, int(_LEFT_OUT * len(ways)))
    return float(ways[-1 - left_out]) if len(ways) > left_out else 0.0


def _wrapped(angle: Array, steps: _Steps, far: Bools) -> tuple[Array, Bools]:
    """Turns (n - 1, 4) to add behind each step, and which steps wrapped.

    One that did is a whole number of turns, but for what the wheel can have rolled meanwhile, and goes from
    one edge of the column to the other, but for as much.
    """
    turns, near = -np.round(steps.moved / _TURN), steps.near[:, None]
    low, high = angle - angle.min(axis=0), angle.max(axis=0) - angle
    across = np.maximum(high[:-1], low[1:]) <= near
    across |= np.maximum(low[:-1], high[1:]) <= near
    whole = np.abs(steps.moved + turns * _TURN) <= near
    return turns, far & whole & across & (steps.reach < np.pi)[:, None]


def _by_rates(steps: _Steps) -> tuple[Array, Bools]:
    """Turns (n - 1, 4) by which angles go as far as the rates say, and where they do to a quarter turn.

    A rate that changes by much within a long gap says too little: it is not known when it did.
    """
    lacking = steps.by_rate - steps.moved
    turns = np.round(np.nan_to_num(lacking) / _TURN)
    steady = (steps.off < _ALIKE_RAD) | (steps.reach <= _TURN)[:, None]
    return turns, steady & (np.abs(lacking - turns * _TURN) < _ALIKE_RAD)


def _as_at_first(angle: Array) -> Bools:
    """Before which rows (n - 1,) all wheels are where the recording began, or at 0."""
    later = angle[1:]
    same = np.all(np.abs(later - angle[0]) < _SAME_RAD, axis=1)
    return np.asarray(same | np.all(np.abs(later) < _SAME_RAD, axis=1))


def _with_turns(angle: Array, turns: Array) -> Array:
    """Angles (n, 4) with turns (n - 1, 4) added behind each step; bit for bit as they are without any."""
    if not turns.any():
        return np.array(angle)
    return np.asarray(angle + _TURN * np.vstack([np.zeros(4), np.cumsum(turns, axis=0)]), dtype=np.float64)


def _refusal(where: str, t_s: Array, steps: _Steps, leaps: Bools, unknown: Bools) -> DataError | None:
    """What the first of the steps is that cannot be used; none where all can."""
    found = np.flatnonzero(np.any(leaps | unknown, axis=1))
    if not len(found):
        return None
    k = int(found[0])
    at_s, lasts_s = float(t_s[k] - t_s[0]), float(steps.lasts_s[k])
    remedy = "leave the recording out, or cut it there"
    if np.any(unknown[k]):
        names = ", ".join(f"phi{i + 1}" for i in np.flatnonzero(unknown[k]))
        longest_s = np.pi * lasts_s / float(steps.reach[k])
        return DataError(
            where,
            f"the wheel angles ({names}) wrap at a whole turn and have no row for {lasts_s:.2f} s, "
            f"{at_s:.2f} s after its begin: how often the wheels turned meanwhile is unknown",
            expected=f"rows at most {longest_s:.2f} s apart, or wheel rates (w) that show it",
            remedy=f"record angles that do not wrap, or the rates; or {remedy}",
        )
    i = int(np.argmax(np.where(leaps[k], np.abs(steps.moved[k]), -1.0)))
    return DataError(
        where,
        f"the wheel angle phi{i + 1} leaps by {steps.moved[k, i]:.2f} rad within {lasts_s:.2f} s, "
        f"{at_s:.2f} s after its begin: further than the wheel can have rolled, and no wrap of its counter",
        expected="angles that go on, or wrap by whole turns from one end of their range to the other",
        remedy=f"where the counter started again, or a row is damaged, {remedy}",
    )
