"""Converts counts to forces, and marks counts that cannot be used."""

import math

import numpy as np

from hil.config.load_cells import LoadCellsConfig
from hil.core.signals import LoadCellSample, Stamp, Status
from hil.streams.stuck_values import StuckTest

_STUCK_S = 0.2
_END = 0.995


class Judge:
    """Converts counts to samples.

    Args:
        config: scales and range.
    """

    def __init__(self, config: LoadCellsConfig) -> None:
        self._n_per_count, self._end_n = config.n_per_count, _END * config.largest_n
        self._stuck = (StuckTest(_STUCK_S), StuckTest(_STUCK_S))

    def sample(self, raw: tuple[int, int], stamp: Stamp) -> LoadCellSample:
        """The sample of one conversion: raw counts of both cells, and its stamp."""
        (first_n, first), (second_n, second) = (self._judged(k, raw[k], stamp.t_ns) for k in (0, 1))
        return LoadCellSample(stamp, np.array((first_n, second_n)), (first, second), raw)

    def _judged(self, cell: int, counts: int, t_ns: int) -> tuple[float, Status]:
        """Force of a cell, N, and whether it can be used."""
        force_n = counts * self._n_per_count[cell]
        if self._stuck[cell].stuck(counts, t_ns):
            return math.nan, Status.FROZEN
        if abs(force_n) >= self._end_n:
            return math.nan, Status.IMPLAUSIBLE
        return force_n, Status.OK
