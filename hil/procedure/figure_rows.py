"""Rows of figures over the time that a run has driven, from bench after bench, never too many."""

from __future__ import annotations

from hil.core.clock import NS_PER_S

_MOST = 4096


class DrivenRows:
    """Rows at equal steps of the time driven; when there are too many, every second one goes.

    Args:
        every_ns: from row to row at first, ns.

    Attributes:
        rows: time driven in s, then the figures.
    """

    def __init__(self, every_ns: int) -> None:
        self.rows: list[tuple[float, ...]] = []
        self._every_ns = every_ns
        self._next_ns = self._last_ns = 0
        self._driven_s = 0.0
        self._thin = 1

    def begin_anew(self, t_ns: int) -> bool:
        """Whether the clock has gone back since the last row: another bench, and a row is due at once."""
        if t_ns >= self._last_ns:
            return False
        self._next_ns = t_ns
        return True

    def is_due(self, t_ns: int) -> bool:
        """Whether it is time for a row."""
        return t_ns >= self._next_ns

    def add(self, t_ns: int, *figures: float) -> None:
        """Take a row at this time of the bench; a pause before it counts as two steps at most."""
        step_ns = self._thin * self._every_ns
        self._driven_s += min(max(t_ns - self._last_ns, 0), 2 * step_ns) / NS_PER_S
        self._last_ns, self._next_ns = t_ns, t_ns + step_ns
        self.interrupt(*figures)
        self._thin_out()

    def follow(self, later: DrivenRows) -> None:
        """Put the rows of benches that were driven elsewhere after these."""
        self.rows += [(self._driven_s + t_s, *figures) for t_s, *figures in later.rows]
        self._driven_s += later._driven_s
        self._last_ns = later._last_ns
        self._thin_out()

    def interrupt(self, *figures: float) -> None:
        """Put a row between two benches, where no time is driven."""
        self.rows.append((self._driven_s, *figures))

    def _thin_out(self) -> None:
        while len(self.rows) > _MOST:
            self.rows, self._thin = self.rows[::2], 2 * self._thin
