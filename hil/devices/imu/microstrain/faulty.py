"""Faults of the emulated MicroStrain sensor itself; the serial line adds those of the wire."""

from __future__ import annotations

import dataclasses

import numpy as np

from hil.devices.imu.microstrain.sensing import Fused
from hil.fakes.faults import PERIODIC, DeviceFaults, FaultPlan, Supported

SUPPORTED_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("rate_rad_s",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "intermittent": PERIODIC,
    "brownout": (),
    "reset": (),
    "jump": ("angle_rad",),
}

_WRONG_RATE_RAD_S = 0.1
_JUMP_RAD = 0.5


class MicrostrainFaults(DeviceFaults):
    """What is wrong with the sensor.

    Options: `wrong,rate_rad_s=` added to every gyro axis; `slow,factor=` stretches the output period;
    `delayed,delay_s=` sends data that much later, with their true stamps; `jump,angle_rad=` turns the
    filter's heading once; `intermittent,period_s=,duty=` is silent for that part of each period.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Fused | None = None
        self.dead = False

    def boot_at_ns(self, t_ns: int) -> int | None:
        """When the sensor last came up because of a fault, if that is news; keeps `dead` up to date."""
        was_dead = self.dead
        self.dead = any(self.find(kind, t_ns) for kind in ("off", "brownout"))
        if was_dead and not self.dead:
            return t_ns
        fault = self.news("reset", t_ns)
        return None if fault is None else fault.start_ns

    def jump_rad(self, t_ns: int) -> float:
        """A step of the heading that is due now, once per fault."""
        fault = self.news("jump", t_ns)
        return 0.0 if fault is None else fault.option("angle_rad", _JUMP_RAD)

    def distort(self, fused: Fused, t_ns: int) -> Fused:
        """What the sensor believes to have measured."""
        if self.find("stuck", t_ns) is not None:
            self._frozen = self._frozen or fused
            return self._frozen
        self._frozen = None
        fault = self.find("wrong", t_ns)
        if fault is None:
            return fused
        extra = fault.option("rate_rad_s", _WRONG_RATE_RAD_S)
        x, y, z = fused.rate
        return dataclasses.replace(fused, rate=(x + extra, y + extra, z + extra))

    def delay_ns(self, t_ns: int) -> int:
        """By how much data come later."""
        fault = self.find("delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()

    def spoil(self, data: bytes, t_ns: int) -> bytes:
        """Bytes as they leave the sensor, and as a client at the wrong baud rate hears them."""
        if self.none or not data:
            return data
        if self.find("garbage", t_ns) or self.find("baud_mismatch", t_ns):
            return self._rng.bytes(len(data))
        fault = self.find("intermittent", t_ns)
        return b"" if fault is not None and fault.interrupts(t_ns) else data
