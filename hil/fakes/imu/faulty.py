"""Faults of the emulated BNO055 that arise in the chip itself; the serial line adds those of the wire."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from hil.clock import nanoseconds
from hil.fakes.faults import Fault, FaultPlan
from hil.fakes.imu import uart
from hil.fakes.imu.output import EMPTY
from hil.fakes.imu.sensors import Sensed

SUPPORTED_FAULTS = (
    "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent", "brownout", "reset", "jump",
)  # fmt: skip

_WRONG_RATE_RAD_S = 0.1
_DELAY_S = 0.1
_JUMP_RAD = 0.5
_SLOWNESS = 5.0
_PERIOD_S, _DUTY = 0.5, 0.5


class ImuFaults:
    """Asks the plan what is wrong now.

    Options: `wrong,rate_rad_s=` added to every gyro axis; `slow,factor=` stretches the output period;
    `delayed,delay_s=` shows old data; `jump,angle_rad=` turns the fused heading once;
    `intermittent,period_s=,duty=` is silent for that part of each period, or answers `code=` instead.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        self._plan, self._name, self._rng = plan, name, rng
        self._done: set[tuple[str, int]] = set()
        self._frozen: bytes | None = None
        self.dead = False

    def boot_at_ns(self, t_ns: int) -> int | None:
        """When the chip last came up because of a fault, if that is news; keeps `dead` up to date."""
        was_dead = self.dead
        self.dead = any(self._plan.find(self._name, kind, t_ns) for kind in ("off", "brownout"))
        if was_dead and not self.dead:
            return t_ns
        fault = self._plan.find(self._name, "reset", t_ns)
        if fault is not None and ("reset", fault.start_ns) not in self._done:
            self._done.add(("reset", fault.start_ns))
            return fault.start_ns
        return None

    def slowness(self, t_ns: int) -> float:
        """Factor on the output period."""
        fault = self._find("slow", t_ns)
        return 1.0 if fault is None else max(1.0, fault.option("factor", _SLOWNESS))

    def delay_ns(self, t_ns: int) -> int:
        """Extra time before an answer while slow."""
        fault = self._find("slow", t_ns)
        return 0 if fault is None else nanoseconds(fault.option("answer_s", 0.0))

    def jump_rad(self, t_ns: int) -> float:
        """A heading step that is due now, once per fault."""
        fault = self._find("jump", t_ns)
        if fault is None or ("jump", fault.start_ns) in self._done:
            return 0.0
        self._done.add(("jump", fault.start_ns))
        return fault.option("angle_rad", _JUMP_RAD)

    def distort(self, sensed: Sensed, t_ns: int) -> Sensed:
        """A sensor that measures wrongly."""
        fault = self._find("wrong", t_ns)
        if fault is None:
            return sensed
        extra = fault.option("rate_rad_s", _WRONG_RATE_RAD_S)
        x, y, z = sensed.rate
        return dataclasses.replace(sensed, rate=(x + extra, y + extra, z + extra))

    def shown(self, block: bytes, history: Iterable[tuple[int, bytes]], t_ns: int) -> bytes:
        """The data registers that a client gets to see."""
        if self._find("stuck", t_ns) is not None:
            if self._frozen is None:
                self._frozen = block
            return self._frozen
        self._frozen = None
        fault = self._find("delayed", t_ns)
        if fault is None:
            return block
        until_ns = t_ns - nanoseconds(fault.option("delay_s", _DELAY_S))
        old = EMPTY
        for at_ns, candidate in history:
            if at_ns > until_ns:
                break
            old = candidate
        return old

    def spoil(self, answer: bytes, t_ns: int) -> bytes:
        """The answer as it leaves the chip."""
        if self._plan.empty or not answer:
            return answer
        if self._find("garbage", t_ns) is not None:
            return self._rng.bytes(len(answer))
        fault = self._find("intermittent", t_ns)
        if fault is None:
            return answer
        period_ns = nanoseconds(fault.option("period_s", _PERIOD_S))
        if (t_ns - fault.start_ns) % period_ns < (1.0 - fault.option("duty", _DUTY)) * period_ns:
            return answer
        code = int(fault.option("code", 0))
        return uart.status(code) if code else b""

    def _find(self, kind: str, t_ns: int) -> Fault | None:
        return None if self._plan.empty else self._plan.find(self._name, kind, t_ns)
