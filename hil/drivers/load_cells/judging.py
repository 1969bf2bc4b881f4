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
        self._config = config
        self._stuck = tuple(StuckTest(_STUCK_S) for _ in range(2))
        self._sequence = 0
        self._latest_ns = -1

    def sample(self, raw: tuple[int, int], t_ns: int, host_ns: int) -> LoadCellSample:
        """A conversion of both cells that was made at `t_ns`."""
        self._latest_ns = t_ns = min(max(t_ns, self._latest_ns + 1), host_ns)
        self._sequence += 1
        forces, states = [math.nan, math.nan], []
        for i, (counts, stuck) in enumerate(zip(raw, self._stuck, strict=True)):
            force_n = counts * self._config.n_per_count[i]
            if stuck.stuck(counts, t_ns):
                states.append(Status.FROZEN)
            elif abs(force_n) >= _END * self._config.largest_n:
                states.append(Status.IMPLAUSIBLE)
            else:
                forces[i] = force_n
                states.append(Status.OK)
        stamp = Stamp(t_ns, host_ns, self._sequence)
        return LoadCellSample(stamp, np.array(forces), tuple(states), raw)
