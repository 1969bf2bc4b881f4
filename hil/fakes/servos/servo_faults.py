"""Faults inside emulated servos; the serial line adds those of the wire.

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
    """Queries the plan for faults of each joint's servo.

    Options: `wrong,share=` is the share of the servo's measured rotation that the wheel turns (its hub
    slips), else `wrong,angle_rad=`; `jump,angle_rad=` (once); `slow,answer_s=` answers late;
    `delayed,delay_s=` shows old measurements; `intermittent,period_s=,duty=` is silent for that part of each
    period; `drop` and `corrupt` per reply with `probability=`.

    Attributes:
        plan: view of the faults of bus and servos. `plan.empty` equals `none` and is cheaper to read.
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
        """Return whether any fault of bus or servos is active."""
        return self.plan.acting(t_ns)

    def find(self, joint: int, kind: str, t_ns: int) -> Fault | None:
        """Return the active fault of this kind on a servo under any of its names, or None.

        The serial line handles `drop` and `corrupt` of the whole bus.
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
        """Return whether the servo has no supply."""
        return self.find(joint, "off", t_ns) is not None or self.find(joint, "brownout", t_ns) is not None

    def due_once(self, joint: int, kind: str, t_ns: int) -> Fault | None:
        """Return an active one-time fault (`reset`, `jump`) at its first query, else None."""
        return self._once.first_activation((joint, kind), self.find(joint, kind, t_ns))

    def jump_counts(self, joint: int, t_ns: int) -> int:
        """Slip of the encoder by a `jump` fault at its first query, counts; else 0."""
        fault = self.due_once(joint, "jump", t_ns)
        return 0 if fault is None else self._counts(joint, fault.option("angle_rad", _JUMP_RAD))

    def share(self, joint: int, t_ns: int) -> float:
        """Joint angle per motor angle: less than 1 while the hub slips."""
        fault = self.find(joint, "wrong", t_ns)
        return 1.0 if fault is None else fault.option("share", 1.0)

    def slid_counts(self, joint: int, share: float, counts: int) -> int:
        """Counts by which the motor has turned further than its joint since the last call.

        Args:
            joint: index.
            share: result of `share`.
            counts: present counts of the joint.
        """
        before, rest = self._slid.get(joint, (counts, 0.0))
        rest += (1.0 / share - 1.0) * (counts - before)
        self._slid[joint] = (counts, rest - round(rest))
        return round(rest)

    def _counts(self, joint: int, angle_rad: float) -> int:
        return round(angle_rad / self._models[joint].rad_per_count)

    def age_ns(self, joint: int, t_ns: int) -> int:
        """Age of the shown measurements under a `delayed` fault."""
        fault = self.find(joint, "delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()

    def measured(self, joint: int, t_ns: int, truth: Measured) -> Measured:
        """Apply `stuck` and `wrong` faults to the measured (position, velocity, current) counts."""
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
        """Extra latency of a reply under a `slow` fault."""
        fault = self.find(joint, "slow", t_ns)
        return 0 if fault is None else nanoseconds(fault.option("answer_s", _SLOW_S))

    def silent(self, joint: int, t_ns: int) -> bool:
        """Return whether this reply is suppressed."""
        fault = self.find(joint, "intermittent", t_ns)
        if fault is not None and fault.silences(t_ns):
            return True
        fault = self.find(joint, "drop", t_ns)
        return fault is not None and fault.hits(self._rng)

    def spoil(self, joint: int, reply: bytes, t_ns: int) -> bytes:
        """Apply `garbage` and `corrupt` faults to a reply."""
        if self.find(joint, "garbage", t_ns) is not None:
            return self._rng.bytes(len(reply))
        fault = self.find(joint, "corrupt", t_ns)
        if fault is None or not fault.hits(self._rng):
            return reply
        place = int(self._rng.integers(len(reply)))
        return reply[:place] + bytes((reply[place] ^ 1 << int(self._rng.integers(8)),)) + reply[place + 1 :]
