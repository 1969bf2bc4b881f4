"""Faults that every emulated inertial unit has: power, resets, heading jumps, wrong rates."""

import numpy as np

from hil.faults.plan import DeviceFaults, FaultPlan

_WRONG_RATE_RAD_S = 0.1
_JUMP_RAD = 0.5


class InertialFaults(DeviceFaults):
    """Faults of any inertial sensor: loss of power, resets, heading jumps, wrong rates.

    Attributes:
        dead: True if the sensor had no power at the last call of `boot_at_ns`.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self.dead = False

    def boot_at_ns(self, t_ns: int) -> int | None:
        """Return the time of a boot caused by a fault at its first query, else None; updates `dead`."""
        was_dead = self.dead
        self.dead = any(self.find(kind, t_ns) for kind in ("off", "brownout"))
        if was_dead and not self.dead:
            return t_ns
        fault = self.first_activation("reset", t_ns)
        return None if fault is None else fault.start_ns

    def jump_rad(self, t_ns: int) -> float:
        """Heading step of a `jump` fault that has just begun, once per fault; else 0."""
        fault = self.first_activation("jump", t_ns)
        return 0.0 if fault is None else fault.option("angle_rad", _JUMP_RAD)

    def wrong_rate_rad_s(self, t_ns: int) -> float:
        """Present error on every axis of the gyroscope."""
        fault = self.find("wrong", t_ns)
        return 0.0 if fault is None else fault.option("rate_rad_s", _WRONG_RATE_RAD_S)
