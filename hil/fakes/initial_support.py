"""How an emulated robot is held at the start: by a tether, by a running fan, or not."""

from __future__ import annotations

from typing import Literal

Start = Literal["by use", "tethered", "running", "off"]

_CARRIED = 0.5
"""Share of the working point's force that carries the robot: a little more than a melamine wall needs."""


class Tether:
    """Stands in for the force of fan or propellers until they have carried the robot once.

    Args:
        start: `tethered`; anything else is no tether.
        working_n: force with which the tether holds.
    """

    def __init__(self, start: Start, working_n: float) -> None:
        self._working_n, self.holds = working_n, start == "tethered"

    def force_n(self, own_n: float) -> float:
        """What acts on the robot when fan or propellers give so much."""
        if self.holds and own_n >= _CARRIED * self._working_n:
            self.holds = False
        return max(own_n, self._working_n) if self.holds else own_n
