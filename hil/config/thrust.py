"""Configuration of the propellers that carry part of the weight (`[thrust]` of the bench file)."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hil.config.assumed_parameters import Parameter, times
from hil.config.device import DeviceConfig
from hil.config.field_types import Baud, Patience, Within
from hil.core.errors import UsageError

STEPS = 180
"""Number of throttle steps of the Teensy."""
STEP_DOWN_S = 0.1
_FOLLOWS_S = 0.6
"""Propellers without pulses have let a robot slide by then, and it is seen."""
Thrust = Annotated[float, Within(1.0, 500.0, "N of all propellers together")]


class ThrustConfig(DeviceConfig):
    """Propellers with any controller.

    Attributes:
        force_n: set-point on a wall; `robot.thrust_compensation` of the weight along the surface when left
            out.
        full_force_n: force of all propellers together at full throttle; force goes with the square of the
            throttle.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("full_force_n", (times(1.5), times(2.0), times(0.6)), ("servos",)),
    )

    force_n: Thrust | None = None
    full_force_n: Thrust = 39.7

    @property
    def scale_keys(self) -> tuple[str, ...]:
        """Keys that scale the push."""
        return ("thrust.full_force_n",)

    def check_force(self, force_n: float, device: str) -> None:
        """Raise `UsageError`, which names the device, for a force that the propellers do not have."""
        if not (math.isfinite(force_n) and 0.0 <= force_n <= self.full_force_n):
            raise UsageError(
                f"{device}: a force of {force_n:g} N",
                expected=f"0 to {self.full_force_n:g} N (thrust.full_force_n)",
                remedy="ask for less, or correct thrust.full_force_n",
            )

    def throttle_for(self, force_n: float) -> float:
        """Throttle 0..1 that gives a force; above 1 where nothing does."""
        return math.sqrt(force_n / self.full_force_n)

    def force_at_n(self, throttle: float) -> float:
        """Force of a throttle 0..1."""
        return self.full_force_n * throttle**2

    @property
    def push_keys(self) -> tuple[str, ...]:
        """Keys of the bench file that scale the push."""
        return ("thrust.full_force_n",)

    def force_lost_after_s(self, force_n: float, least_n: float) -> float:
        """Time until a controller that did not understand its last command gives less than `least_n`.

        A robot that has rested for this time without a command is held by the controller alone.

        Args:
            force_n: last set-point.
            least_n: force that the robot needs; 0 for all that the controller may take away.

        Returns:
            Time (s); `inf` if unknown.
        """
        return math.inf


class TeensyConfig(ThrustConfig):
    """A Teensy that turns lines into pulses for the propellers' controllers; it never answers.

    Attributes:
        port: device path or any pyserial URL.
        baud: baud rate of its serial line.
        repeat_s: interval at which the throttle is sent again: the next line replaces a lost one, and after a
            restart the propellers push again before the robot slides.
        write_timeout_s: time after which a port that takes nothing counts as failed.
    """

    model: Literal["teensy"] = "teensy"
    port: str = Field("/dev/ttyACM0", min_length=1)
    baud: Baud = 115_200
    repeat_s: Annotated[float, Within(0.02, 2.0, "a lost line lasts so long")] = 0.05
    write_timeout_s: Patience = 0.1

    def force_lost_after_s(self, force_n: float, least_n: float) -> float:
        """After a wrong line the throttle falls by a step every 100 ms; without lines it stays."""
        steps = math.ceil(STEPS * (self.throttle_for(force_n) - self.throttle_for(least_n)))
        return STEP_DOWN_S * max(steps, 0) + _FOLLOWS_S
