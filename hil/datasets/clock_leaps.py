"""Takes leaps of the clock, and long pauses, out of the stamps of a recording.

Where neither log has a row, and no wheel went on although it rolled before and behind, no time passed: the
clock was set. A pause in which nothing was recorded is shortened; nothing is computed from its length.
"""

import numpy as np

from hil.core.geometry import Array
from hil.datasets.cleaning import count
from hil.datasets.usable_rows import Rows

_LEAP_S, _PERIODS, _PAUSE_S = 1.0, 20.0, 30.0
_BESIDE_S, _ROLLS_RAD, _WENT = 0.3, 0.5, 0.2
_ONE_TURN_RAD = 6.4
"""Range of a counter that may wrap at each turn: how far it went in a pause is unknown."""


def without_leaps(wheels: Rows, poses: Rows, repairs: dict[str, int]) -> tuple[Rows, Rows]:
    """Both logs with one row after the other where the clock leapt, and pauses of 30 s at most.

    Args:
        wheels: rows of the wheels, angles in the first four columns.
        poses: rows of the ground truth.
        repairs: counts of repairs by name; changed in place.
    """
    t_s = np.unique(np.concatenate([wheels.t_s, poses.t_s]))
    period_s = float(np.median(np.diff(wheels.t_s)))
    gaps = np.flatnonzero(np.diff(t_s) > max(_LEAP_S, _PERIODS * period_s))
    if len(gaps) == 0 or np.ptp(wheels.values[:, :4], axis=0).min() < _ONE_TURN_RAD:
        return wheels, poses
    begin_s, taken_s = t_s[gaps], np.zeros(len(gaps))
    for k, gap in enumerate(gaps):
        lasts_s = float(t_s[gap + 1] - t_s[gap])
        taken_s[k] = max(0.0, lasts_s - _PAUSE_S)
        if _leapt(wheels, float(t_s[gap]), lasts_s):
            count(repairs, f"leap of the clock by {lasts_s:.2f} s, over which no wheel went on, taken out", 1)
            taken_s[k] = lasts_s - period_s
    earlier_s = np.concatenate([[0.0], np.cumsum(taken_s)])

    def closed(rows: Rows) -> Rows:
        by_s: Array = earlier_s[np.searchsorted(begin_s, rows.t_s)]
        return Rows(rows.t_s - by_s, rows.values, rows.receive_s - by_s)

    return closed(wheels), closed(poses)


def _leapt(wheels: Rows, begin_s: float, lasts_s: float) -> bool:
    """Whether wheels that roll before and behind a gap did not go on in it."""
    t_s, phi = wheels.t_s, wheels.values[:, :4]
    last = int(np.searchsorted(t_s, begin_s, side="right")) - 1
    first, before = last + 1, int(np.searchsorted(t_s, begin_s - _BESIDE_S))
    if first >= len(t_s):
        return False
    behind = int(np.searchsorted(t_s, t_s[first] + _BESIDE_S)) - 1
    if before >= last or behind <= first:
        return False
    rates = [np.abs(phi[b] - phi[a]) / (t_s[b] - t_s[a]) for a, b in ((before, last), (first, behind))]
    expected = np.minimum(*rates) * lasts_s
    wheel = int(np.argmax(expected))
    went = abs(float(phi[first, wheel] - phi[last, wheel]))
    return bool(expected[wheel] > _ROLLS_RAD and went < _WENT * expected[wheel])
