"""Faults inside the emulated BNO055; the serial line adds those of the wire."""

from collections.abc import Iterable

import numpy as np

from hil.core.clock import nanoseconds
from hil.fakes.imu.bno055 import uart as bno055_uart
from hil.fakes.imu.bno055.register_encoding import EMPTY
from hil.fakes.imu.bno055.sensor_physics import Sensed
from hil.fakes.imu.inertial_faults import InertialFaults
from hil.faults.fault import PERIODIC, Supported
from hil.faults.plan import FaultPlan

SUPPORTED_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "wrong": ("rate_rad_s",),
    "slow": ("factor", "answer_s"),
    "delayed": ("delay_s",),
    "intermittent": (*PERIODIC, "code"),
    "brownout": (),
    "reset": (),
    "jump": ("angle_rad",),
}


class ImuFaults(InertialFaults):
    """Faults of the BNO055.

    Options: `wrong,rate_rad_s=` added to every gyro axis; `slow,factor=` stretches the output period
    and `answer_s=` delays answers;
    `delayed,delay_s=` shows old data; `jump,angle_rad=` turns the fused heading once;
    `intermittent,period_s=,duty=` is silent for that part of each period, or answers `code=` instead.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: bytes | None = None

    def delay_ns(self, t_ns: int) -> int:
        """Extra latency of an answer under a `slow` fault."""
        fault = self.find("slow", t_ns)
        return 0 if fault is None else nanoseconds(fault.option("answer_s", 0.0))

    def distort(self, sensed: Sensed, t_ns: int) -> Sensed:
        """Add the error of a `wrong` fault to the measured rates."""
        extra = self.wrong_rate_rad_s(t_ns)
        if not extra:
            return sensed
        x, y, z = sensed.rate
        return sensed._replace(rate=(x + extra, y + extra, z + extra))

    def shown(self, block: bytes, history: Iterable[tuple[int, bytes]], t_ns: int) -> bytes:
        """Data registers as the client reads them: present, frozen or delayed."""
        if self.find("stuck", t_ns) is not None:
            if self._frozen is None:
                self._frozen = block
            return self._frozen
        self._frozen = None
        fault = self.find("delayed", t_ns)
        if fault is None:
            return block
        until_ns = t_ns - fault.delay_ns()
        old = EMPTY
        for at_ns, candidate in history:
            if at_ns > until_ns:
                break
            old = candidate
        return old

    def spoil(self, answer: bytes, t_ns: int) -> bytes:
        """Apply an `intermittent` fault to an answer."""
        fault = self.find("intermittent", t_ns)
        if not answer or fault is None or not fault.silences(t_ns):
            return answer
        code = int(fault.option("code", 0))
        return bno055_uart.status(code) if code else b""
