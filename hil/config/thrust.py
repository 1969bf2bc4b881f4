"""Configuration of the propellers that carry part of the weight (`[thrust]` of the bench file)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from hil.config.device import DeviceConfig
from hil.config.values import Baud, Patience, Within

Thrust = Annotated[float, Within(1.0, 500.0, "N of all propellers together")]


class ThrustConfig(DeviceConfig):
    """Of propellers with any controller.

    Attributes:
        force_n: what they are asked for on a wall; `robot.thrust_compensation` of the weight along the
            surface when left out.
        full_force_n: of all propellers together at full throttle; force goes with the square of the throttle.
    """

    force_n: Thrust | None = None
    full_force_n: Thrust = 39.7

    def throttle_for(self, force_n: float) -> float:
        """Throttle 0..1 that gives a force; above 1 where nothing does."""
        return math.sqrt(force_n / self.full_force_n)

    def force_at_n(self, throttle: float) -> float:
        """Force of a throttle 0..1."""
        return self.full_force_n * throttle**2


class TeensyConfig(ThrustConfig):
    """A Teensy that turns lines into pulses for the propellers' controllers; it never answers.

    Attributes:
        port: device path or any pyserial URL.
        baud: of its serial line.
        repeat_s: the throttle is sent again so often: a line that got lost does not stay lost, and after a
            restart the propellers push again before the robot slides.
        write_timeout_s: after which a port that takes nothing counts as failed.
    """

    model: Literal["teensy"] = "teensy"
    port: str = Field("/dev/ttyACM0", min_length=1)
    baud: Baud = 115_200
    repeat_s: Annotated[float, Within(0.02, 2.0, "a lost line lasts so long")] = 0.05
    write_timeout_s: Patience = 0.1
