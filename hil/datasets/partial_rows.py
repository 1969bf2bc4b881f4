"""Completes rows that lack some of their columns: signals in rows of their own, or changed values only."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.core.geometry import Array
from hil.core.interpolation import between_samples
from hil.datasets.cleaning import Log, count

LONGEST_S = 0.1
"""Longest time between two values of a column across which it is interpolated."""
_WHOLE = 0.5
_TIMES_PERIOD = 2.5
_USUAL, _SLOWEST_S = 1.5, 0.12
_RESTING = 0.02
"""Least share of a column that is empty in a log of changed values only; below it cells were lost."""


def hold_unchanged(t_s: Array, table: Array, columns: Sequence[int], repairs: dict[str, int]) -> None:
    """Fill empty cells of columns of changed values only with the value before, in place.

    Such a column never repeats a value, and has none while it rests. Where all columns are empty, and behind
    that one is further from its value before than it usually goes, that is a gap, and stays empty.

    Args:
        t_s: (n,) times of the rows, in the order of the file, s.
        table: (n, k) rows.
        columns: columns of one sensor.
        repairs: counts of repairs by name; changed in place.
    """
    rows = np.flatnonzero(np.isfinite(t_s))
    rows = rows[np.argsort(t_s[rows], kind="stable")]
    at = np.ix_(rows, np.array(columns, dtype=np.int_))
    values = table[at]
    known = np.isfinite(values)
    if known.all() or not known.any(axis=0).all():
        return
    before, behind = _nearest(values), _nearest(values[::-1])[::-1]
    steps = [np.abs(np.diff(column[own])) for column, own in zip(values.T, known.T, strict=True)]
    usual = np.array([_USUAL * np.median(own) if len(own) else 0.0 for own in steps])
    near = np.all(~(np.abs(behind - before) > usual), axis=1) | known.any(axis=1)
    gaps = np.cumsum(~near)
    filled = 0
    for j, own_steps in enumerate(steps):
        own = np.flatnonzero(known[:, j])
        lasts_s = np.diff(t_s[rows][own])
        whole = gaps[own[1:]] == gaps[own[:-1]]
        rests = whole & (own_steps <= usual[j]) & (lasts_s > _TIMES_PERIOD * np.median(lasts_s))
        if not own_steps.all() or not rests.any() or np.median(lasts_s) > _SLOWEST_S:
            continue
        fill = ~known[:, j] & near & np.isfinite(before[:, j])
        if np.count_nonzero(fill) < _RESTING * len(fill):
            continue
        values[fill, j] = before[fill, j]
        filled += int(np.count_nonzero(fill))
    table[at] = values
    count(repairs, "cells that are empty as nothing had changed filled with the value before", filled)


def _nearest(values: Array) -> Array:
    """Last known value (n, k) of each column at or before each row; NaN before the first."""
    rows = np.where(np.isfinite(values), np.arange(len(values))[:, None], 0)
    return np.take_along_axis(values, np.maximum.accumulate(rows, axis=0), axis=0)


def completed(log: Log, needed: int, kind: str, angles: Sequence[int], repairs: dict[str, int]) -> Log:
    """Log whose rows have all needed columns, where less than half of its rows have them.

    Rows are then the instants of the first column, and the others are interpolated between their own values.

    Args:
        log: rows as read from the file.
        needed: number of leading columns that a row needs.
        kind: name of the rows in the repairs.
        angles: columns whose whole turns mean nothing.
        repairs: counts of repairs by name; changed in place.
    """
    known = np.isfinite(log.values[:, :needed])
    rows = np.flatnonzero(np.isfinite(log.t_s) & known.any(axis=1))
    if log.receive_s is not None or np.count_nonzero(known[rows].all(axis=1)) > _WHOLE * len(rows):
        return log
    rows = rows[np.argsort(log.t_s[rows], kind="stable")]
    t_s, values = log.t_s[rows], log.values[rows].copy()
    for j in angles:
        own = np.isfinite(values[:, j])
        values[own, j] = np.unwrap(values[own, j])
    first = np.isfinite(values[:, 0])
    whole = values[first]
    for j in range(1, values.shape[1]):
        own = np.isfinite(values[:, j])
        whole[:, j] = at_instants(t_s[first], t_s[own], values[own, j : j + 1])[:, 0]
    apart_s = max(_period_s(t_s[np.isfinite(column)]) for column in values.T[:needed])
    what = (
        f"{kind} rows interpolated, as columns have rows of their own, up to {apart_s:.3f} s apart (median)"
    )
    count(repairs, what, len(whole))
    return replace(log, t_s=t_s[first], values=whole)


def _period_s(t_s: Array) -> float:
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0


def at_instants(at_s: Array, t_s: Array, values: Array) -> Array:
    """Interpolate columns (m, k) of one signal, an angle first, at times (m,) to other instants (n,).

    NaN between values more than 0.1 s, or 2.5 typical periods, apart, and where a counter wraps between two.
    """
    t_s, order = np.unique(t_s, return_index=True)
    values = values[order]
    longest_s = max(LONGEST_S, _TIMES_PERIOD * _period_s(t_s))
    found = between_samples(at_s, t_s, values, longest=longest_s, before=longest_s, after=longest_s)
    if len(t_s) > 1:
        end = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        wraps = np.abs(values[end, 0] - values[end - 1, 0]) > np.pi
        found[wraps & (at_s > t_s[end - 1]) & (at_s < t_s[end])] = np.nan
    return found
