"""Moves one joint as an operator commands it; every other joint keeps its place.

The set-points depend only on the commands of the cycles, so that replay repeats them. A cycle without a
command means rest.
"""

from dataclasses import dataclass

import numpy as np

from hil.controller.laws import clip
from hil.core.errors import UsageError
from hil.core.external_commands import ExternalCommands
from hil.core.geometry import Array
from hil.core.interfaces import ExternalController
from hil.core.known_names import JOG
from hil.core.signals import SERVOS, CycleRecord, WheelMeasurement, WheelSetpoint


@dataclass(frozen=True)
class JogLimits:
    """Limits of one joint.

    Attributes:
        wheel_rate_rad_s, wheel_acceleration_rad_s2: largest rate of a wheel, and of its change.
        steering_rad, steering_rate_rad_s: largest angle of a steering axis either way, and its largest rate.
        period_s: period of the loop.
    """

    wheel_rate_rad_s: float
    wheel_acceleration_rad_s2: float
    steering_rad: float
    steering_rate_rad_s: float
    period_s: float


class JogController(ExternalController):
    """Controller of one joint.

    Args:
        name: `jog:` and the name of the servo.
        limits: limits of that joint.

    Raises:
        UsageError: no servo has this name.
    """

    def __init__(self, name: str, limits: JogLimits) -> None:
        joint = name.removeprefix(JOG)
        if joint not in SERVOS:
            raise UsageError(f"jog of {joint!r}", expected=", ".join(SERVOS))
        self.name, self._limits = name, limits
        index = SERVOS.index(joint)
        self._steers, self._wheel = index >= len(SERVOS) // 2, index % (len(SERVOS) // 2)
        self.ask = _nobody
        self.heard: ExternalCommands | None = None
        self.reset()

    def reset(self) -> None:
        """Reset to the state before a run."""
        self.begun, self.warning = True, ""
        self._rate_rad_s = 0.0
        self._steering_rad: Array | None = None

    def update(self, seen: CycleRecord, wheels: WheelMeasurement | None) -> WheelSetpoint | None:
        """Set-point of this cycle: the joint by its command, the others as they were."""
        received = self.heard = self.ask(seen)
        if wheels is None:
            return None
        if self._steering_rad is None:
            self._steering_rad = wheels.steering_rad.copy()
        wanted_rad_s = float(received.commands[-1].velocity_rad_s[0]) if received.commands else 0.0
        rates, limits = np.zeros(4), self._limits
        if self._steers:
            rate_rad_s = clip(wanted_rad_s, limits.steering_rate_rad_s)
            now_rad = float(self._steering_rad[self._wheel])
            most_rad = max(limits.steering_rad, abs(now_rad))
            self._steering_rad[self._wheel] = clip(now_rad + rate_rad_s * limits.period_s, most_rad)
        else:
            change = clip(wanted_rad_s, limits.wheel_rate_rad_s) - self._rate_rad_s
            self._rate_rad_s += clip(change, limits.wheel_acceleration_rad_s2 * limits.period_s)
            rates[self._wheel] = self._rate_rad_s
        return WheelSetpoint(rates, self._steering_rad.copy())


def _nobody(_: CycleRecord) -> ExternalCommands:
    """No commands: the default while no operator is attached."""
    return ExternalCommands()
