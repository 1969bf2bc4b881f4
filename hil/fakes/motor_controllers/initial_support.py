"""Holding of an emulated robot at the start: by a tether, by a running fan, or none."""

from typing import Literal

InitialSupport = Literal["by use", "tethered", "running", "off"]

_CARRIED = 0.5
"""Share of the force at the working point that holds the robot: slightly more than a melamine wall needs."""


class Tether:
    """Replaces the force of fan or propellers until that force has held the robot once.

    Args:
        start: `tethered` for a tether; no tether otherwise.
        working_n: holding force of the tether.
    """

    def __init__(self, start: InitialSupport, working_n: float) -> None:
        self._working_n, self.holds = working_n, start == "tethered"

    def force_n(self, own_n: float) -> float:
        """Return the force on the robot for a present force of fan or propellers."""
        if self.holds and own_n >= _CARRIED * self._working_n:
            self.holds = False
        return max(own_n, self._working_n) if self.holds else own_n
