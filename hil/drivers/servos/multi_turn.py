"""Multi-turn positions that go on counting when a servo starts over within one turn.

A register in velocity mode counts turns until the servo restarts; then it shows one turn again. A
change that no motor could have made since the last reading is such a restart.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import add, sub

import numpy as np

from hil.config.servo_models import ServoModel

_MARGIN_COUNTS = 512
_WORD = 1 << 32
_COASTING_S = 0.1
_ZERO = (0,) * 8

Counts = np.ndarray

ALL_SERVOS, NO_SERVOS = np.ones(8, dtype=bool), np.zeros(8, dtype=bool)
for _who in (ALL_SERVOS, NO_SERVOS):
    _who.setflags(write=False)


class MultiTurnCounter:
    """Adds the turns that the registers of eight servos have lost.

    Args:
        model: of the servos: how they count, and how fast they turn at most.

    Attributes:
        offset: (8,) counts to add to a register.
    """

    def __init__(self, model: ServoModel) -> None:
        self._turn_counts = model.counts_per_turn
        self._top_counts_s = model.top_speed_rad_s / model.rad_per_count
        self.offset: Sequence[int] = _ZERO
        self._last: Sequence[int] = _ZERO
        self._velocity: Sequence[int] = _ZERO
        self._last_ns = np.zeros(8, dtype=np.int64)
        self._speed_counts = model.rad_s_per_count / model.rad_per_count
        self._known = np.zeros(8, dtype=bool)
        self._restarted = np.zeros(8, dtype=bool)
        self._together_ns: int | None = None

    def restarted(self, joint: int) -> None:
        """Note that a servo has restarted: its next reading is bridged to the nearest turn."""
        self._restarted[joint] = True
        self._part()

    def follow(
        self, raw: Sequence[int], velocity: Sequence[int], seen: np.ndarray, t_ns: int
    ) -> tuple[Sequence[int], np.ndarray]:
        """Continuous counts, and which servos have started over.

        Args:
            raw: (8,) registers.
            velocity: (8,) registers, to bridge a gap.
            seen: (8,) whether the servo answered; `ALL_SERVOS` itself where all did.
            t_ns: time of the reading.
        """
        counts = raw if self.offset is _ZERO else list(map(add, raw, self.offset))
        if seen is ALL_SERVOS and self._together_ns is not None:
            moved = list(map(sub, counts, self._last))
            most = self._top_counts_s * ((t_ns - self._together_ns) * 1e-9) + _MARGIN_COUNTS
            if max(moved) <= most and -min(moved) <= most:
                self._last, self._velocity, self._together_ns = counts, velocity, t_ns
                return counts, NO_SERVOS
        self._part()
        counts, jumped = self._look_at_each(np.array(counts), np.array(velocity), seen, t_ns)
        self._together_ns = t_ns if seen is ALL_SERVOS else None
        return counts, jumped

    def _part(self) -> None:
        """From now on each has its own time of the last reading."""
        if self._together_ns is not None:
            self._last_ns[:] = self._together_ns
            self._together_ns = None

    def _look_at_each(
        self, counts: Counts, velocity: Counts, seen: np.ndarray, t_ns: int
    ) -> tuple[list[int], np.ndarray]:
        elapsed_s = (t_ns - self._last_ns) * 1e-9
        change = counts - self._last
        impossible = np.abs(change) > self._top_counts_s * elapsed_s + _MARGIN_COUNTS
        jumped = seen & self._known & (impossible | self._restarted)
        if jumped.any():
            counts = self._bridge(counts, change, jumped, elapsed_s)
        self._restarted &= ~seen
        self._last = np.where(seen, counts, self._last).tolist()
        self._last_ns = np.where(seen, t_ns, self._last_ns)
        self._velocity = np.where(seen, velocity, self._velocity).tolist()
        self._known |= seen
        return counts.tolist(), jumped

    def _bridge(self, counts: Counts, change: Counts, jumped: np.ndarray, elapsed_s: np.ndarray) -> Counts:
        coasted = np.array(self._velocity) * self._speed_counts * np.minimum(elapsed_s, _COASTING_S)
        excess = change - coasted
        words = np.rint(excess / _WORD).astype(np.int64) * _WORD
        turns = np.rint((excess - words) / self._turn_counts).astype(np.int64) * self._turn_counts
        lost = np.where(jumped, words + turns, 0)
        self.offset = (np.array(self.offset) - lost).tolist()
        bridged: Counts = counts - lost
        return bridged
