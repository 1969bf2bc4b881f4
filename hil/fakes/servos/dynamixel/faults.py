"""Faults inside emulated servos; the serial line adds those of the bus.

Names: the bus (`servos`), a servo by joint (`servo.drive_FL`) or by ID (`servo.3`).
"""

from itertools import chain

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.clock import nanoseconds
from hil.core.signals import SERVOS
from hil.faults.fault import PERIODIC, Fault, Supported
from hil.faults.messages import Messages
from hil.faults.plan import FaultPlan, Once

BUS_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "wrong": ("angle_rad", "share"),
    "slow": ("answer_s",),
    "delayed": ("delay_s",),
    "reset": (),
    "brownout": (),
    "jump": ("angle_rad",),
}
_OF_ONE: Supported = {
    "drop": ("probability",),
    "corrupt": ("probability",),
    "garbage": (),
    "intermittent": PERIODIC,
    "silent": (),
}
"""Faults of the replies of a single servo; those of the bus come from the line."""
SERVO_FAULTS: Supported = {**BUS_FAULTS, **_OF_ONE}

_WRONG_RAD, _JUMP_RAD = 0.1, 0.5
_SLOW_S = 0.002

Measured = tuple[int, int, int]


class ServoFaults:
    """Queries the plan for faults of each joint's servo.

    Options: `wrong,share=` is the share of the servo's measured rotation that the wheel turns (its hub
    slips), else `wrong,angle_rad=`; `jump,angle_rad=` (once); `slow,answer_s=` answers late;
    `delayed,delay_s=` shows old measurements. What becomes of the replies of a single servo: `replies`.

    Attributes:
        plan: view of the faults of bus and servos. `plan.empty` equals `none` and is cheaper to read.
        replies: faults of the replies of each servo, by joint.
    """

    def __init__(
        self,
        plan: FaultPlan,
        bus: str,
        ids: tuple[int, ...],
        rng: np.random.Generator,
        models: tuple[ServoModel, ...],
    ) -> None:
        self._models = models
        self._names = [(bus, f"servo.{SERVOS[j]}", f"servo.{ids[j]}") for j in range(len(ids))]
        self.plan = plan.of(*chain.from_iterable(self._names))
        self.replies = tuple(Messages(plan, names[1:], rng, _OF_ONE) for names in self._names)
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

    def find(self, joint: int, kind: str, t_ns: int) -> Fault | None:
        """Return the active fault of this kind on a servo under any of its names, or None."""
        if not self.plan.has(kind):
            return None
        for name in self._names[joint]:
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
