"""From counts to forces: what both ways of delivery share, and which counts cannot be used."""

from __future__ import annotations

import math

import numpy as np

from hil.config.load_cells import LoadCellsConfig
from hil.drivers.stuck import StuckTest
from hil.vocabulary.signals import LoadCellSample, Stamp, Status

_STUCK_S = 0.2
_END = 0.995


class Judge:
    """Makes samples of counts.

    Args:
        config: scales and range.
    """

    def __init__(self, config: LoadCellsConfig) -> None:
        self._n_per_count, self._end_n = config.n_per_count, _END * config.largest_n
        self._stuck = (StuckTest(_STUCK_S), StuckTest(_STUCK_S))
        self._sequence = 0
        self._latest_ns = -1

    def sample(self, raw: tuple[int, int], t_ns: int, host_ns: int) -> LoadCellSample:
        """A conversion of both cells that was made at `t_ns`."""
        self._latest_ns = t_ns = min(max(t_ns, self._latest_ns + 1), host_ns)
        self._sequence += 1
        (first_n, first), (second_n, second) = self._judged(0, raw[0], t_ns), self._judged(1, raw[1], t_ns)
        stamp = Stamp(t_ns, host_ns, self._sequence)
        return LoadCellSample(stamp, np.array((first_n, second_n)), (first, second), raw)

    def _judged(self, cell: int, counts: int, t_ns: int) -> tuple[float, Status]:
        """Force of a cell, N, and whether it can be used."""
        force_n = counts * self._n_per_count[cell]
        if self._stuck[cell].stuck(counts, t_ns):
            return math.nan, Status.FROZEN
        if abs(force_n) >= self._end_n:
            return math.nan, Status.IMPLAUSIBLE
        return force_n, Status.OK
