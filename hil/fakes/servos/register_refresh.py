"""Servos that renew what they show at a rhythm of their own instead of at every look.

The public recordings have one joint state every 16.0 ms: half of the periods within 0.04 ms, a standard
deviation of 0.5 ms, one period in five hundred above 20 ms, the longest 29 ms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.core.clock import nanoseconds
from hil.fakes.servos.bus_truth import ServoBusOptions
from hil.fakes.world import Scheduled

_RARE = 0.05
_RARE_FACTOR = 8.0
_SHORTEST_GAP_S = 0.004


class Cadence(Scheduled):
    """Calls `renew` at the recorded rhythm.

    Args:
        options: `cadence_s` and what belongs to it.
        rng: random stream of the bus.
        renew: takes one measurement.
    """

    alone = True
    announces = True

    def __init__(self, options: ServoBusOptions, rng: np.random.Generator, renew: Callable[[], None]) -> None:
        self._options, self._rng, self._renew = options, rng, renew
        self._period_ns = nanoseconds(options.cadence_s)
        self._slot = 0
        self._due_ns = 0

    def next_due_ns(self) -> int:
        """When the servos measure next."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Measure, and plan the next time about its place on the grid."""
        self._renew()
        self._slot += 1
        self._due_ns = max(t_ns + 1, self._slot * self._period_ns + nanoseconds(self._late_s()))

    def _late_s(self) -> float:
        options, rng = self._options, self._rng
        kind = float(rng.random())
        late_s = options.cadence_jitter_s * float(rng.standard_normal())
        if kind < options.cadence_gaps_per_s * options.cadence_s:
            most_s = max(options.cadence_longest_gap_s - options.cadence_s, _SHORTEST_GAP_S)
            return float(rng.uniform(_SHORTEST_GAP_S, most_s))
        return late_s * _RARE_FACTOR if kind > 1.0 - _RARE else late_s
