"""Faults of emulated servos that arise in the servo itself; the serial line adds those of the wire.

Names: the bus (`servos`), a servo by joint (`servo.drive_FL`) or by ID (`servo.3`).
"""

from __future__ import annotations

from itertools import chain

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.clock import nanoseconds
from hil.core.signals import SERVOS
from hil.fakes.active_faults import FaultPlan, Once
from hil.fakes.fault import PERIODIC, STRIKES, Fault, Supported

BUS_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("angle_rad", "share"),
    "slow": ("answer_s",),
    "delayed": ("delay_s",),
    "intermittent": PERIODIC,
    "reset": (),
    "brownout": (),
    "jump": ("angle_rad",),
}
_LINE_ONLY: Supported = {"drop": STRIKES, "corrupt": STRIKES}
SERVO_FAULTS: Supported = {**BUS_FAULTS, **_LINE_ONLY}

_WRONG_RAD, _JUMP_RAD = 0.1, 0.5
_SLOW_S = 0.002

Measured = tuple[int, int, int]


class ServoFaults:
    """Asks the plan what is wrong with each joint's servo now.

    Options: `wrong,share=` of what its servo measures is what a wheel turns by (its hub slips), else
    `wrong,angle_rad=`; `wrong` and `jump,angle_rad=` (once), `slow,answer_s=` answers late,
    `delayed,delay_s=` shows old measurements, `intermittent,period_s=,duty=` is silent for that part of
    each period, `drop` and `corrupt` per reply with `probability=`.

    Attributes:
        plan: what concerns bus and servos; a caller in every step reads `plan.empty`, which is `none`.
    """

    def __init__(
        self,
        plan: FaultPlan,
        bus: str,
        ids: tuple[int, ...],
        rng: np.random.Generator,
        models: tuple[ServoModel, ...],
    ) -> None:
        self._rng, self._models = rng, models
        self._names = [(bus, f"servo.{SERVOS[j]}", f"servo.{ids[j]}") for j in range(len(ids))]
        self.plan = plan.of(*chain.from_iterable(self._names))
        self._once = Once()
        self._frozen: dict[int, Measured] = {}
        self._slid: dict[int, tuple[int, float]] = {}
        for names in self._names:
            for name in names[1:]:
                plan.declare(name, SERVO_FAULTS)

    @property
    def none(self) -> bool:
        """Whether no fault of any servo is planned, nor has been."""
        return self.plan.empty

    def acting(self, t_ns: int) -> bool:
        """Whether any fault of bus or servos acts now."""
        return self.plan.acting(t_ns)

    def find(self, joint: int, kind: str, t_ns: int) -> Fault | None:
        """The active fault of that kind on a servo under any of its names.

        `drop` and `corrupt` of the whole bus are the line's affair.
        """
        if not self.plan.has(kind):
            return None
        names = self._names[joint]
        for name in names[1:] if kind in _LINE_ONLY else names:
            fault = self.plan.find(name, kind, t_ns)
            if fault is not None:
                return fault
        return None

    def unpowered(self, joint: int, t_ns: int) -> bool:
        """Whether the servo has no supply."""
        return self.find(joint, "off", t_ns) is not None or self.find(joint, "brownout", t_ns) is not None

    def due_once(self, joint: int, kind: str, t_ns: int) -> Fault | None:
        """A fault that acts once (`reset`, `jump`) and has not acted yet."""
        return self._once.news((joint, kind), self.find(joint, kind, t_ns))

    def jump_counts(self, joint: int, t_ns: int) -> int:
        """A slip of the encoder that is due now."""
        fault = self.due_once(joint, "jump", t_ns)
        return 0 if fault is None else self._counts(joint, fault.option("angle_rad", _JUMP_RAD))

    def share(self, joint: int, t_ns: int) -> float:
        """How far the joint turns for each radian that its motor does: less than 1 where its hub slips."""
        fault = self.find(joint, "wrong", t_ns)
        return 1.0 if fault is None else fault.option("share", 1.0)

    def slid_counts(self, joint: int, share: float, counts: int) -> int:
        """By how much the motor has turned further than its joint since the last call.

        Args:
            joint: index.
            share: as `share` says.
            counts: of the joint, now.
        """
        before, rest = self._slid.get(joint, (counts, 0.0))
        rest += (1.0 / share - 1.0) * (counts - before)
        self._slid[joint] = (counts, rest - round(rest))
        return round(rest)

    def _counts(self, joint: int, angle_rad: float) -> int:
        return round(angle_rad / self._models[joint].rad_per_count)

    def age_ns(self, joint: int, t_ns: int) -> int:
        """How old the measurements are that the servo shows."""
        fault = self.find(joint, "delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()

    def measured(self, joint: int, t_ns: int, truth: Measured) -> Measured:
        """(position, velocity, current) counts as the servo believes them."""
        if self.find(joint, "stuck", t_ns) is not None:
            return self._frozen.setdefault(joint, truth)
        self._frozen.pop(joint, None)
        fault = self.find(joint, "wrong", t_ns)
        if fault is None:
            return truth
        if "share" in fault.options:
            return (truth[0], round(truth[1] / self.share(joint, t_ns)), truth[2])
        extra = self._counts(joint, fault.option("angle_rad", _WRONG_RAD))
        return (truth[0] + extra, truth[1], truth[2])

    def late_ns(self, joint: int, t_ns: int) -> int:
        """Extra time before an answer."""
        fault = self.find(joint, "slow", t_ns)
        return 0 if fault is None else nanoseconds(fault.option("answer_s", _SLOW_S))

    def silent(self, joint: int, t_ns: int) -> bool:
        """Whether this reply is not given."""
        fault = self.find(joint, "intermittent", t_ns)
        if fault is not None and fault.interrupts(t_ns):
            return True
        fault = self.find(joint, "drop", t_ns)
        return fault is not None and fault.strikes(self._rng)

    def spoil(self, joint: int, reply: bytes, t_ns: int) -> bytes:
        """The reply as it leaves the servo."""
        if self.find(joint, "garbage", t_ns) is not None:
            return self._rng.bytes(len(reply))
        fault = self.find(joint, "corrupt", t_ns)
        if fault is None or not fault.strikes(self._rng):
            return reply
        place = int(self._rng.integers(len(reply)))
        return reply[:place] + bytes((reply[place] ^ 1 << int(self._rng.integers(8)),)) + reply[place + 1 :]
