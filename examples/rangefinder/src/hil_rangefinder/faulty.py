"""Faults of the emulated TF-Luna; the serial line adds those of the wire."""

from __future__ import annotations

import numpy as np

from hil.fakes.fault import PERIODIC, Supported
from hil.fakes.faults import DeviceFaults, FaultPlan
from hil_rangefinder.packets import Reading

SUPPORTED_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("offset_m", "strength"),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "intermittent": PERIODIC,
    "brownout": (),
    "reset": (),
    "jump": ("offset_m",),
}

_WRONG_M, _JUMP_M = 0.1, 0.5


class RangeFaults(DeviceFaults):
    """What is wrong with the sensor.

    Options: `wrong,offset_m=` on every distance, or `wrong,strength=` of every echo; `jump,offset_m=` as
    something stands in the beam; `slow,factor=`; `delayed,delay_s=`; `intermittent,period_s=,duty=`. `off`,
    `brownout` and `reset` make it start again with the settings that were saved.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Reading | None = None
        self._was_dead = False

    def dead(self, t_ns: int) -> bool:
        """Whether the sensor has no power."""
        return any(self.find(kind, t_ns) is not None for kind in ("off", "brownout"))

    def restarted(self, t_ns: int) -> bool:
        """Whether it has just come up again."""
        was_dead, self._was_dead = self._was_dead, self.dead(t_ns)
        return (was_dead and not self._was_dead) or self.news("reset", t_ns) is not None

    def delay_ns(self, t_ns: int) -> int:
        """Extra latency."""
        fault = self.find("delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()

    def offset_m(self, t_ns: int) -> float:
        """Added to every distance."""
        wrong, jump = self.find("wrong", t_ns), self.find("jump", t_ns)
        offset_m = 0.0 if jump is None else -jump.option("offset_m", _JUMP_M)
        if wrong is not None and "strength" not in wrong.options:
            offset_m += wrong.option("offset_m", _WRONG_M)
        return offset_m

    def strength(self, strength: int, t_ns: int) -> int:
        """Strength of the echo."""
        wrong = self.find("wrong", t_ns)
        if wrong is None or "strength" not in wrong.options:
            return strength
        return int(min(max(wrong.options["strength"], 0.0), 65535.0))

    def shown(self, reading: Reading, t_ns: int) -> Reading:
        """The reading, or the one at which it is stuck."""
        if self.find("stuck", t_ns) is None:
            self._frozen = None
            return reading
        self._frozen = self._frozen or reading
        return self._frozen

    def spoil(self, data: bytes, t_ns: int) -> bytes:
        """The packet as it leaves the sensor; nothing where it is silent."""
        if self.none:
            return data
        if self.find("garbage", t_ns) is not None:
            return self._rng.bytes(len(data))
        silent = self.find("intermittent", t_ns)
        return b"" if silent is not None and silent.interrupts(t_ns) else data
