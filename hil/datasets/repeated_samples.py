"""Takes out repeated samples: wheel values that a logger wrote again without reading them.

It read the wheels more slowly than it wrote rows. Between two reads such a log is a staircase: the wheels
seem to stand, and then to leap. The value is that of the first row of each step. Repeats are taken out for
one period before the next value, and the columns are interpolated there; a wheel that stands for longer keeps
its rows.
"""

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.cleaning import count

_MOVED, _WINDOW_S = 0.1, 0.5
_HELD = 0.4
_LONGEST_S = 0.5
_JITTER, _SLOWER = 1.2, 1.5
_TURN, _LITTLE_RAD = 2.0 * np.pi, 0.1


def without_held(t_s: Array, w: Array, repairs: dict[str, int]) -> tuple[Bools, Array]:
    """Mask (n,) of rows to keep, and values (n, k) with repeated values replaced by interpolated ones.

    Args:
        t_s: (n,) times, s, increasing.
        w: (n, 8 or 12) wheel angles, steering angles and, optionally, wheel rates.
        repairs: counts of repairs by name; changed in place.
    """
    keep, out = np.ones(len(t_s), dtype=np.bool_), w
    for columns in (slice(0, 4), slice(4, 8)):
        own = [_fresh(t_s, _unwrapped(column)) for column in w.T[columns]]
        period_s = max(lasts_s for _, lasts_s in own)
        if period_s == 0.0:
            continue
        out = out.copy() if out is w else out
        for j, (fresh, _) in enumerate(own, start=columns.start):
            out[:, j] = np.interp(t_s, t_s[fresh], _unwrapped(w[fresh, j]))
            if columns.start == 0 and w.shape[1] > 8:
                out[:, 8 + j] = np.interp(t_s, t_s[fresh], w[fresh, 8 + j])
        if columns.start == 0:
            keep = np.any([fresh for fresh, _ in own], axis=0)
        name = "wheel" if columns.start == 0 else "steering"
        what = f"{name} angles repeated between reads {period_s:.3f} s apart (median) interpolated"
        count(repairs, what, sum(np.count_nonzero(~fresh) for fresh, _ in own))
    return keep, out


def _unwrapped(column: Array) -> Array:
    """Angles (n,) without wraps, where they stay within a turn."""
    return np.unwrap(column) if np.ptp(column) <= _TURN + _LITTLE_RAD else column


def _fresh(t_s: Array, column: Array) -> tuple[Bools, float]:
    """Mask (n,) of values that are no repeats, and the period of the reads, s; 0 where nothing is held.

    Values are held where, while the angle moves by more than 0.1 rad in half a second, four tenths of them or
    more repeat the one before.
    """
    changed = np.concatenate([[True], np.diff(column) != 0.0])
    ahead_s, back_s = (np.interp(t_s + side * 0.5 * _WINDOW_S, t_s, column) for side in (1.0, -1.0))
    moving = np.abs(ahead_s - back_s) > _MOVED
    if np.count_nonzero(moving) < 2 or np.mean(changed[moving]) > 1.0 - _HELD:
        return np.ones(len(t_s), dtype=np.bool_), 0.0
    at_s = t_s[changed & moving]
    lasts_s = np.diff(at_s)
    lasts_s = lasts_s[lasts_s < _LONGEST_S]
    if not len(lasts_s):
        return np.ones(len(t_s), dtype=np.bool_), 0.0
    period_s = float(np.median(lasts_s))
    if period_s < _SLOWER * float(np.median(np.diff(t_s))):
        return np.ones(len(t_s), dtype=np.bool_), 0.0
    starts = np.flatnonzero(changed)
    behind = np.searchsorted(starts, np.arange(len(t_s)), side="right")
    follows = behind < len(starts)
    next_s = np.where(follows, t_s[starts[np.minimum(behind, len(starts) - 1)]], np.inf)
    brief = ~follows & (t_s - t_s[starts[-1]] < _JITTER * period_s) & (t_s[-1] - t_s[starts[-1]] < period_s)
    held = ~changed & ((next_s - t_s < _JITTER * period_s) | brief)
    return ~held, period_s
