"""Takes out poses that were filled in between fewer measured ones by straight lines.

Of three poses on one line through space and time the middle one says nothing. Measured poses of a robot that
moves have noise: they are never on such lines but for single ones. Where most rows of a moving robot are, the
bends between the lines are the measured poses.
"""

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.cleaning import count

_MOVES_M_S, _TURNS_RAD_S, _MOST, _FEWEST, _BESIDE = 2e-3, 0.01, 0.6, 8, 2
_ROUNDING = 1.5
_LEAST = 1e-12


def measured(t_s: Array, pose: Array, repairs: dict[str, int]) -> Bools:
    """Mask (m,) of the rows of ground truth to keep.

    Rows are filled in where six tenths of those in which the robot moves are on the line between their
    neighbours, to the digits of the file, and most bends, eight at least, are of one or two rows. A robot
    that is simulated without noise bends over many rows or none. At rest a row in a period is kept.

    Args:
        t_s: (m,) times, s, increasing.
        pose: (m, 3) poses, m, m, rad.
        repairs: counts of repairs by name; changed in place.
    """
    keep = np.ones(len(t_s), dtype=np.bool_)
    values = np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
    before_s, after_s = np.diff(t_s)[:-1, None], np.diff(t_s)[1:, None]
    share = after_s / (before_s + after_s)
    off = np.abs(share * values[:-2] + (1.0 - share) * values[2:] - values[1:-1])
    lasts_s, step = (before_s + after_s)[:, 0], values[2:] - values[:-2]
    moves = (np.hypot(*step.T[:2]) > _MOVES_M_S * lasts_s) | (np.abs(step[:, 2]) > _TURNS_RAD_S * lasts_s)
    bent = np.any(off > _ROUNDING * np.array([_digits(column) for column in values.T]), axis=1)
    rows = np.flatnonzero(moves)
    if len(rows) == 0 or np.mean(bent[rows]) > 1.0 - _MOST:
        return keep
    bends = np.flatnonzero(bent & moves)
    groups = np.split(bends, np.flatnonzero(np.diff(bends) > 1) + 1)
    single = sum(len(group) <= _BESIDE for group in groups)
    if single < max(_FEWEST, 0.5 * len(groups)):
        return keep
    apart_s = float(np.median(np.diff([t_s[1 + group[0]] for group in groups])))
    first_of_period = np.diff(np.floor((t_s - t_s[0]) / apart_s))[:-1] > 0.0
    filled = np.where(moves, ~bent, ~first_of_period)
    filled[[row for group in groups if len(group) <= _BESIDE for row in group[1:]]] = True
    keep[1:-1] = ~filled
    what = f"ground-truth rows filled in between poses {apart_s:.2g} s apart (median) left out"
    count(repairs, what, np.count_nonzero(filled))
    return keep


def _digits(column: Array) -> float:
    """Rounding of the numbers of a column (m,): the coarsest power of ten of which all are multiples."""
    for digits in range(1, 10):
        unit = 10.0**-digits
        if np.max(np.abs(np.round(column / unit) * unit - column)) < _LEAST:
            return unit
    return max(_LEAST, 1e-9 * float(np.max(np.abs(column))))
