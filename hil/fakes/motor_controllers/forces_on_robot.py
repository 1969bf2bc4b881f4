"""Sums the forces of several motors on the robot and adds a tether until they can carry it."""

from collections.abc import Callable

from hil.fakes.motor_controllers.initial_support import InitialSupport, Tether


class Load:
    """Total force of one or several motors of the same kind.

    Args:
        working_n: total true force at the working point.
        gain: ratio of the true force to the force by the ratings.
        apply: function that receives the force in N that acts on the robot.
        motors: number of motors; each gives an equal share.
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
        """Force of each motor at the working point by the ratings."""
        return self._working_n / (self.gain * len(self._forces_n))

    def begin(self, start: InitialSupport) -> None:
        """Set how the robot is held when the world starts."""
        self._tether = Tether(start, self._working_n)

    def set(self, motor: int, force_n: float) -> None:
        """Set the force of one motor and apply the new total."""
        self._forces_n[motor] = force_n
        self._apply(self._tether.force_n(sum(self._forces_n)))
