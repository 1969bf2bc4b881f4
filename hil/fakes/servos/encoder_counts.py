"""Counts of the eight servos, in flat vectors.

Their history holds angles as they were on the grid, a row of eight for each of its points; they become counts
when somebody looks.
"""

from __future__ import annotations

from hil.core.geometry import Array
from hil.core.named_records import Ints
from hil.support.numba_jit import inner, kernel

# Rows of the scales (3, 8): counts per rad, velocity counts per count of a span, counts per A.
PER_RAD, PER_SPAN, PER_A = range(3)

# Rows of what is measured now (2, 8): angles in rad and currents in A.
ANGLES, CURRENTS = range(2)

# Rows of what the servos show (3, 8): encoders, velocities and currents.
SHOWN_COUNTS, SHOWN_VELOCITIES, SHOWN_CURRENTS = range(3)

OLD, SPAN = 3, 19
"""How old the firmware's velocity is, and over how many points of the grid it is taken."""


@inner
def count(history: Array, dither: Array, scales: Array, first: int, last: int) -> None:
    """Make counts of the angles in the history.

    Args:
        history: (n, 8), which it changes.
        dither: (n, 8) counts.
        scales: (3, 8).
        first: row that holds angles.
        last: so does every row up to this one; none does where `first` is behind it.
    """
    per_rad = scales[PER_RAD]
    for row in range(first, last + 1):
        values, added = history[row], dither[row]
        for j in range(8):
            values[j] = float(round(values[j] * per_rad[j] + added[j]))


@kernel
def show(now: Array, history: Array, dither: Array, scales: Array, first: int, row: int, shown: Ints) -> None:
    """Encoders, velocities and currents in the servos' counts, truncated towards zero.

    Args:
        now: (2, 8).
        history: (n, 8), which it changes.
        dither: (n, 8) counts.
        scales: (3, 8).
        first: row of the history from which on it holds angles.
        row: of the latest point.
        shown: (3, 8) whole numbers: the result.
    """
    count(history, dither, scales, first, row)
    angles, amps, added = now[ANGLES], now[CURRENTS], dither[row]
    newer, older = history[row - OLD], history[row - OLD - SPAN]
    counts, velocities, currents = shown[SHOWN_COUNTS], shown[SHOWN_VELOCITIES], shown[SHOWN_CURRENTS]
    per_rad, per_span, per_a = scales[PER_RAD], scales[PER_SPAN], scales[PER_A]
    for j in range(8):
        counts[j] = round(angles[j] * per_rad[j] + added[j])
        velocities[j] = int((newer[j] - older[j]) * per_span[j])
        currents[j] = int(amps[j] * per_a[j])
