"""Adds up the forces of motors on the robot, and the tether that holds until they carry it."""

from __future__ import annotations

from collections.abc import Callable

from hil.fakes.initial_support import Start, Tether


class Load:
    """The force of one or several motors that do the same.

    Args:
        working_n: force of all at the working point, as it acts on the robot.
        gain: true force over what the ratings say.
        apply: takes the force in N that acts.
        motors: how many there are; each gives its share.
    """

    def __init__(
        self, working_n: float, gain: float, apply: Callable[[float], object], motors: int = 1
    ) -> None:
        self._working_n, self._apply = working_n, apply
        self.gain = gain / motors
        self._forces_n = [0.0] * motors
        self._tether = Tether("off", working_n)

    @property
    def nominal_n(self) -> float:
        """Force at the working point by the ratings of all motors."""
        return self._working_n / (self.gain * len(self._forces_n))

    def begin(self, start: Start) -> None:
        """How the robot hangs when the world begins."""
        self._tether = Tether(start, self._working_n)

    def set(self, motor: int, force_n: float) -> None:
        """A motor gives another force."""
        self._forces_n[motor] = force_n
        self._apply(self._tether.force_n(sum(self._forces_n)))
