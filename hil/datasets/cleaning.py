"""Repairs the rows of a log: drops rows without numbers, makes stamps increase, counts each repair."""

from dataclasses import dataclass, replace
from typing import SupportsInt

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.truth_jumps import Rows

_GAP_S, _GAPS_LONGER = 0.1, 1.5
MIN_STEP_S = 1e-6
_CREDIBLE = 1e12
_ROLLED_RAD = 0.5
_STAMPED_S = 1.0
_DIPS, _MOST_DIPS = 2.0, 0.02
_FAR_S, _REGULAR, _BESIDE = 1.0, 1.5, 3.0
"""A stamp is far off from 1 s on; times between rows, as multiples of the typical one, without a gap."""
UNIT_QUATERNION = (0.9, 1.1)
"""Range of the squared norm of a quaternion that counts as a rotation."""
NO_HEADING = "ground-truth poses left out because their quaternion is no rotation, so no heading"
INTEGRATED = (
    "wheels whose angles are integrated from their rates, with their errors: a fit takes these for radii"
)


@dataclass(frozen=True)
class Log:
    """Rows as read from a file, before repair.

    Attributes:
        t_s: (n,) best time stamp, s (the source's clock, shifted to the receiver's by the median delay).
        values: (n, k) values of the rows.
        receive_s: (n,) receive stamps, s, where the file has them.
    """

    t_s: Array
    values: Array
    receive_s: Array | None = None


def count(repairs: dict[str, int], what: str, number: SupportsInt) -> None:
    """Add a number to the count of a repair; 0 adds no entry."""
    if int(number):
        repairs[what] = repairs.get(what, 0) + int(number)


def count_gaps(repairs: dict[str, int], t_s: Array, what: str) -> None:
    """Count gaps in stamps (n,), s: steps over 0.1 s that are clearly longer than the median step."""
    lasts_s = np.diff(t_s)
    gap_s = max(_GAP_S, round(_GAPS_LONGER * float(np.median(lasts_s)), 2))
    count(repairs, what.format(gap_s), np.count_nonzero(lasts_s > gap_s + MIN_STEP_S))


def emptiest(log: Log, names: tuple[str, ...]) -> str:
    """Remark, in brackets, on the column with the most rows without a number; empty where none lack."""
    values = credible(np.column_stack([log.t_s, log.values[:, : len(names) - 1]]))
    lacking = np.count_nonzero(~np.isfinite(values), axis=0)
    worst = int(np.argmax(lacking))
    if not lacking[worst]:
        return ""
    return f" ({names[worst]} holds no number in {lacking[worst]} of {len(values)} rows)"


def clean(log: Log, needed: int, kind: str, repairs: dict[str, int]) -> tuple[Array, Array, Array]:
    """Finite rows in strictly increasing time: stamps (n,), values (n, k) and receive stamps (n,).

    Receive stamps are made increasing the authors' way.

    Args:
        log: rows as read from the file.
        needed: number of leading columns that must be finite.
        kind: name of the rows in the repairs.
        repairs: counts of repairs by name; changed in place.
    """
    t_s, values = credible(log.t_s), credible(log.values)
    receive_s = log.receive_s if log.receive_s is not None else t_s
    unstamped = without_stamp(t_s)
    count(repairs, f"{kind} rows stamped 0 among others dropped", np.count_nonzero(unstamped))
    good = np.isfinite(t_s) & np.all(np.isfinite(values[:, :needed]), axis=1)
    count(repairs, f"{kind} rows without numbers dropped", np.count_nonzero(~good & ~unstamped))
    good &= ~unstamped
    t_s, values, receive_s = t_s[good], values[good], receive_s[good]
    if len(misplaced := far_stamps(t_s)):
        at_s = t_s[misplaced[0] - 1] - t_s.min(where=_all_but(t_s, misplaced), initial=np.inf)
        what = (
            f"{kind} rows stamped far from the rows beside them dropped (first {at_s:.2f} s after its begin)"
        )
        count(repairs, what, len(misplaced))
        kept = _all_but(t_s, misplaced)
        t_s, values, receive_s = t_s[kept], values[kept], receive_s[kept]
    if len(t_s) == 0:
        return t_s, values, receive_s
    count(repairs, f"{kind} stamps out of order sorted", np.count_nonzero(np.diff(t_s) < 0))
    order = np.argsort(t_s, kind="stable")
    t_s, values, receive_s = t_s[order], values[order], receive_s[order]
    keep = np.concatenate([[True], np.diff(t_s) > MIN_STEP_S])
    count(repairs, f"{kind} rows with a repeated stamp dropped", np.count_nonzero(~keep))
    t_s, values, receive_s = t_s[keep], values[keep], receive_s[keep]
    return t_s, values, increasing(receive_s)


def dips(t_s: Array) -> Rows:
    """Indices of rows whose stamp, of (n,), is before that of the row before."""
    return np.asarray(np.flatnonzero(np.diff(t_s) < 0.0) + 1, dtype=np.int_)


def most_dips(t_s: Array) -> float:
    """Largest number of `dips` that rows (n,) in order may have; with more the file has no time order."""
    return max(_DIPS, _MOST_DIPS * len(t_s))


def without_stamp(t_s: Array) -> Bools:
    """Mask of rows (n,) stamped 0 between rows at 1 s or later: these have no stamp."""
    out = np.zeros(len(t_s), dtype=np.bool_)
    if len(dips(t_s)) > most_dips(t_s):
        return out
    out[1:-1] = (t_s[1:-1] == 0.0) & (t_s[:-2] > _STAMPED_S) & (t_s[2:] > _STAMPED_S)
    return out


def far_stamps(t_s: Array) -> Rows:
    """Indices of single rows, of (n,), whose stamps are more than 1 s off those of the rows beside them.

    A row that came late has its place at its stamp, where a row is missing. A damaged stamp has none: other
    rows are there, or all others are later or earlier.
    """
    if len(t_s) < 3 or len(dips(t_s)) > most_dips(t_s):
        return np.empty(0, dtype=np.int_)
    typical_s = float(np.median(np.abs(np.diff(t_s))))
    before, own, after = t_s[:-2], t_s[1:-1], t_s[2:]
    beside = (after > before) & (after - before <= _BESIDE * typical_s)
    far = np.flatnonzero(beside & ((own < before - _FAR_S) | (own > after + _FAR_S))) + 1
    others = np.sort(t_s[_all_but(t_s, far)])
    at = np.searchsorted(others, t_s[far])
    earlier, later = others[np.maximum(at - 1, 0)], others[np.minimum(at, len(others) - 1)]
    return np.asarray(far[later - earlier <= _REGULAR * typical_s], dtype=np.int_)


def _all_but(t_s: Array, rows: Rows) -> Bools:
    """Mask of the rows (n,) without some of them."""
    out = np.ones(len(t_s), dtype=np.bool_)
    out[rows] = False
    return out


def with_angles(log: Log, repairs: dict[str, int]) -> Log:
    """Integrate wheel angles from the rates, where no wheel has angles and all have rates."""
    if log.values.shape[1] < 12:
        return log
    angles, rates = (np.isfinite(log.values[:, k : k + 4]).any(axis=0) for k in (0, 8))
    if angles.any() or not rates.all():
        return log
    values = np.array(log.values)
    for wheel in range(4):
        rows = np.flatnonzero(np.isfinite(log.t_s) & np.isfinite(values[:, 8 + wheel]))
        rows = rows[np.argsort(log.t_s[rows], kind="stable")]
        rate = values[rows, 8 + wheel]
        way = 0.5 * (rate[1:] + rate[:-1]) * np.diff(log.t_s[rows])
        values[rows, wheel] = np.concatenate([[0.0], np.cumsum(way)])
    count(repairs, INTEGRATED, 4)
    return replace(log, values=values)


def recorded_rates(w: Array, repairs: dict[str, int]) -> Array:
    """Wheel rates (n, 4) of rows w (n, 8 or 12); NaN where missing, or all 0 while wheels roll."""
    if w.shape[1] < 12:
        return np.full((len(w), 4), np.nan)
    if not w[:, 8:12].any() and np.max(np.ptp(w[:, :4], axis=0)) > _ROLLED_RAD:
        count(repairs, "columns of wheel rates (w) that are 0 throughout taken as not recorded", 4)
        return np.full((len(w), 4), np.nan)
    return np.array(w[:, 8:12])


def credible(values: Array) -> Array:
    """Values of a file, in the given shape; NaN in place of numbers too large for any unit and for sums."""
    return np.where(np.abs(values) < _CREDIBLE, values, np.nan)


def increasing(t_s: Array) -> Array:
    """Stamps (n,), s, made strictly increasing: each at least 1 us after its predecessor."""
    step = np.arange(len(t_s)) * MIN_STEP_S
    return np.asarray(np.maximum.accumulate(t_s - step) + step, dtype=np.float64)
