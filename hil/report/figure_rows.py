"""Rows of values over the driven time of a run, across all its benches, in limited number."""

from __future__ import annotations

from hil.core.clock import NS_PER_S

_MOST = 4096


class DrivenRows:
    """Rows at equal steps of driven time. When there are too many, every second row is removed.

    Args:
        every_ns: initial step between rows, ns.

    Attributes:
        rows: driven time in s, then the values.
    """

    def __init__(self, every_ns: int) -> None:
        self.rows: list[tuple[float, ...]] = []
        self._every_ns = every_ns
        self._next_ns = self._last_ns = 0
        self._driven_s = 0.0
        self._thin = 1

    def begin_anew(self, t_ns: int) -> bool:
        """Whether the clock has gone back since the last row (a new bench); if so, a row is due at once."""
        if t_ns >= self._last_ns:
            return False
        self._next_ns = t_ns
        return True

    def is_due(self, t_ns: int) -> bool:
        """Whether it is time for a row."""
        return t_ns >= self._next_ns

    def add(self, t_ns: int, *figures: float) -> None:
        """Add a row at a bench time; a pause before it counts as at most two steps of driven time."""
        step_ns = self._thin * self._every_ns
        self._driven_s += min(max(t_ns - self._last_ns, 0), 2 * step_ns) / NS_PER_S
        self._last_ns, self._next_ns = t_ns, t_ns + step_ns
        self.interrupt(*figures)
        self._thin_out()

    def follow(self, later: DrivenRows) -> None:
        """Append the rows of benches that were driven in another process."""
        self.rows += [(self._driven_s + t_s, *figures) for t_s, *figures in later.rows]
        self._driven_s += later._driven_s
        self._last_ns = later._last_ns
        self._thin_out()

    def interrupt(self, *figures: float) -> None:
        """Append a row at the current driven time, for example between two benches."""
        self.rows.append((self._driven_s, *figures))

    def _thin_out(self) -> None:
        while len(self.rows) > _MOST:
            self.rows, self._thin = self.rows[::2], 2 * self._thin
