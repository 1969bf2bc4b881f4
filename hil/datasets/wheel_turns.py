"""Unwraps wheel angles: distinguishes counter wraps from gaps, restarts and unknown turns.

A jump by a whole number of turns, from one end of the column's range to the other, is a wrap. A step that a
wheel can have rolled since the row before is left as it is, however long that time was. A step by less than
half a turn that no wheel can have rolled is refused, and so are such steps of the steering while wheels roll.
Where a counter wraps at every turn, rows further apart than half a turn takes do not determine the number of
turns; the wheel rates may. Nothing else is guessed.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools

WRAPS = "wheel-angle wrap-arounds undone"
BY_RATES = "wheel angles behind a gap given their turns by the wheel rates"

_TURN = 2.0 * np.pi
_LITTLE_RAD = 0.1
_FASTEST_RAD_S, _FASTER = 5.0, 1.25
_FEWEST_LEFT_OUT, _LEFT_OUT = 2, 0.02
"""Number (at least) and share of the fastest steps left out, because they may be jumps."""
_GRID_S = 0.1
_UNMOVED_RAD = 0.02
_SAME_RAD = 1e-6
_ALIKE_RAD = 0.25 * _TURN
_TIMES_NEAR, _HUNG_S = 2.5, 1.0
"""Margin for steps of less than half a turn, and longest time for which a servo may repeat its last angle."""
_STEERED_RAD_S, _STEERED_RAD = 20.0, 0.5
"""Four times the speed of the fastest steering recorded, and a margin for coarse counters."""
_TOGETHER_RAD = 0.1
_BESIDE_S = 0.1


@dataclass(frozen=True)
class Turns:
    """Unwrapped wheel angles.

    Attributes:
        angle: (n, 4) cumulative, rad; refused steps are unchanged.
        repairs: counts of repairs by name.
        refusal: error for the first jump that is no wrap, or gap with an unknown number of turns.
    """

    angle: Array
    repairs: Mapping[str, int]
    refusal: DataError | None


@dataclass(frozen=True)
class _Steps:
    """Steps from row to row.

    Attributes:
        lasts_s: (n - 1,) duration, s.
        moved: (n - 1, 4) change of the angles, rad.
        reach: (n - 1,) largest possible turn of a wheel, rad.
        near: (n - 1,) `reach` with a margin for stamp jitter; angles closer than this count as equal.
        by_rate: (n - 1, 4) turn by the wheel rates, rad, NaN where there are none.
        off: (n - 1, 4) largest error of `by_rate` for a rate that changed monotonically, rad.
    """

    lasts_s: Array
    moved: Array
    reach: Array
    near: Array
    by_rate: Array
    off: Array


def whole_turns(where: str, t_s: Array, angle: Array, rate: Array) -> Turns:
    """Undo wraps of wheel angles, and find jumps that are no wraps.

    The largest possible turn between two rows follows from the fastest wheel of the recording, with a quarter
    of margin, and at least 5 rad/s. A step within that reach is always left alone. A step of less than half a
    turn is a jump from 2.5 times that reach on: stamps jitter, and a bus that repeats an angle catches up.

    Args:
        where: the file, for messages.
        t_s: (n,) times of the rows, s, increasing.
        angle: (n, 4) wheel angles as in the file, rad.
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
    leaps = ((far & ~wraps) | restarts[:, None] | _sudden(t_s, steps)) & ~unsure
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
    """Largest speed of any wheel over a tenth of a second, rad/s; wraps do not count."""
    ways = []
    grid_s = np.arange(t_s[0], t_s[-1], _GRID_S)
    for column in angle.T:
        rolled = column if np.ptp(column) > _TURN + _LITTLE_RAD else np.unwrap(column)
        ways.append(np.sort(np.abs(np.diff(np.interp(grid_s, t_s, rolled)))))
    return max(map(_without_jumps, ways)) / _GRID_S


def _without_jumps(ways: Array) -> float:
    """The largest of the sorted values (n,), after leaving out the steps that may be jumps."""
    left_out = max(_FEWEST_LEFT_OUT, int(_LEFT_OUT * len(ways)))
    return float(ways[-1 - left_out]) if len(ways) > left_out else 0.0


def _wrapped(angle: Array, steps: _Steps, far: Bools) -> tuple[Array, Bools]:
    """Turns (n - 1, 4) to add after each step, and mask of the steps that wrapped.

    A wrap is a whole number of turns and goes from one end of the column's range to the other, both within
    what the wheel can have rolled meanwhile.
    """
    turns, near = -np.round(steps.moved / _TURN), steps.near[:, None]
    low, high = angle - angle.min(axis=0), angle.max(axis=0) - angle
    across = np.maximum(high[:-1], low[1:]) <= near
    across |= np.maximum(low[:-1], high[1:]) <= near
    whole = np.abs(steps.moved + turns * _TURN) <= near
    return turns, far & whole & across & (steps.reach < np.pi)[:, None]


def _sudden(t_s: Array, steps: _Steps) -> Bools:
    """Mask (n - 1, 4) of steps, by half a turn at most, over 2.5 times the reach since the last change."""
    fastest = steps.reach / steps.lasts_s
    reach = np.maximum(fastest[:, None] * _since_s(t_s, steps.moved != 0.0), steps.near[:, None])
    size = np.abs(steps.moved)
    return np.asarray((size > _TIMES_NEAR * reach) & (size <= np.pi), dtype=np.bool_)


def _since_s(t_s: Array, changed: Bools) -> Array:
    """Time (n - 1, k), s, that each step of rows (n,) may have taken: since the last one that changed."""
    rows = np.arange(len(changed))[:, None]
    before = np.maximum.accumulate(np.where(changed, rows + 1, 0), axis=0)
    first = np.vstack([np.zeros((1, changed.shape[1]), dtype=np.int_), before[:-1]])
    lasts_s = t_s[1:, None] - t_s[first]
    return np.asarray(np.maximum(np.minimum(lasts_s, _HUNG_S), np.diff(t_s)[:, None]), dtype=np.float64)


def without_turns(steering: Array) -> Array:
    """Steering angles (n, 4) in time order that do not leap by whole turns, medians within half a turn of 0.

    A whole turn of a steering axis means nothing: encoders give (-pi, pi], [0, 2 pi), or count turns.
    """
    unwrapped = np.unwrap(steering, axis=0)
    turns = np.round(np.median(unwrapped, axis=0) / _TURN)
    return np.asarray(unwrapped - _TURN * turns, dtype=np.float64)


def check_steering(where: str, t_s: Array, steering: Array, angle: Array) -> None:
    """Refuse steering angles of single wheels that leap while the wheels roll.

    A leap is faster than 20 rad/s since the last row in which any angle changed, and more than 0.5 rad. Whole
    turns do not count, and neither do leaps while the wheels stand: no way is computed from them. Where all
    four wheels are steered in one row, the angles are those of a simulation, or commands, and are taken as
    they are.

    Args:
        where: the file, for messages.
        t_s: (n,) times of the rows, s, increasing.
        steering: (n, 4) steering angles, rad.
        angle: (n, 4) wheel angles, rad, unwrapped.

    Raises:
        DataError: names the first leap.
    """
    moved = np.diff(steering, axis=0)
    moved -= _TURN * np.round(moved / _TURN)
    changed = np.any(np.diff(np.hstack([steering, angle]), axis=0) != 0.0, axis=1, keepdims=True)
    since_s = np.maximum(_since_s(t_s, changed), np.median(np.diff(t_s)))
    leaps = np.abs(moved) > _STEERED_RAD_S * since_s + _STEERED_RAD
    leaps[np.min(np.abs(moved), axis=1) > _TOGETHER_RAD] = False
    for k in np.flatnonzero(leaps.any(axis=1)).tolist():
        around_s = (t_s[k] - _BESIDE_S, t_s[k + 1] + _BESIDE_S)
        rolled = np.diff([np.interp(around_s, t_s, column) for column in angle.T])
        if np.max(np.abs(rolled)) < _UNMOVED_RAD:
            continue
        i = int(np.argmax(np.where(leaps[k], np.abs(moved[k]), -1.0)))
        raise DataError(
            where,
            f"the steering angle delta{i + 1} leaps by {moved[k, i]:.2f} rad within "
            f"{t_s[k + 1] - t_s[k]:.3g} s, {t_s[k] - t_s[0]:.2f} s after its begin, while the wheels roll: "
            "no steering is that fast",
            expected="angles that the servos measured in that row",
            remedy="delete the damaged rows, leave the recording out, or cut it there",
        )


def _by_rates(steps: _Steps) -> tuple[Array, Bools]:
    """Turns (n - 1, 4) at which the angles agree with the rates, and mask where they do to a quarter turn.

    A rate that changes much within a long gap is not used: the time of the change is unknown.
    """
    lacking = steps.by_rate - steps.moved
    turns = np.round(np.nan_to_num(lacking) / _TURN)
    steady = (steps.off < _ALIKE_RAD) | (steps.reach <= _TURN)[:, None]
    return turns, steady & (np.abs(lacking - turns * _TURN) < _ALIKE_RAD)


def _as_at_first(angle: Array) -> Bools:
    """Mask of rows (n - 1,), after the first, where all wheels are at their first angle, or at 0."""
    later = angle[1:]
    same = np.all(np.abs(later - angle[0]) < _SAME_RAD, axis=1)
    return np.asarray(same | np.all(np.abs(later) < _SAME_RAD, axis=1))


def _with_turns(angle: Array, turns: Array) -> Array:
    """Angles (n, 4) with turns (n - 1, 4) added after each step; bit-identical without any."""
    if not turns.any():
        return np.array(angle)
    return np.asarray(angle + _TURN * np.vstack([np.zeros(4), np.cumsum(turns, axis=0)]), dtype=np.float64)


def _refusal(where: str, t_s: Array, steps: _Steps, leaps: Bools, unknown: Bools) -> DataError | None:
    """Error for the first step that cannot be used; None where all can."""
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
