"""Faults of the emulated MicroStrain sensor itself; the serial line adds those of the wire."""

from __future__ import annotations

import dataclasses

import numpy as np

from hil.devices.imu.microstrain.emulated_sensing import Fused
from hil.fakes.active_faults import FaultPlan
from hil.fakes.fault import PERIODIC, Supported
from hil.fakes.imu.bno055_faults import InertialFaults

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


class MicrostrainFaults(InertialFaults):
    """What is wrong with the sensor.

    Options: `wrong,rate_rad_s=` added to every gyro axis; `slow,factor=` stretches the output period;
    `delayed,delay_s=` sends data that much later, with their true stamps; `jump,angle_rad=` turns the
    filter's heading once; `intermittent,period_s=,duty=` is silent for that part of each period.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Fused | None = None

    def distort(self, fused: Fused, t_ns: int) -> Fused:
        """What the sensor believes to have measured."""
        if self.find("stuck", t_ns) is not None:
            self._frozen = self._frozen or fused
            return self._frozen
        self._frozen = None
        extra = self.wrong_rate_rad_s(t_ns)
        if not extra:
            return fused
        x, y, z = fused.rate
        return dataclasses.replace(fused, rate=(x + extra, y + extra, z + extra))

    def spoil(self, data: bytes, t_ns: int) -> bytes:
        """Bytes as they leave the sensor, and as a client at the wrong baud rate hears them."""
        if self.none or not data:
            return data
        if self.find("garbage", t_ns) or self.find("baud_mismatch", t_ns):
            return self._rng.bytes(len(data))
        fault = self.find("intermittent", t_ns)
        return b"" if fault is not None and fault.interrupts(t_ns) else data
