"""Who on the bus hears an instruction, who takes a goal, who answers the read of every cycle.

That follows from registers and power, which hardly ever change: it is found out once and kept until
a servo says that something about it has changed.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.fakes.servos import protocol
from hil.fakes.servos.answering import FORM
from hil.fakes.servos.block import GoalBlock, MotionBlock
from hil.fakes.servos.group import Wanted
from hil.fakes.servos.options import ServoBusOptions
from hil.fakes.servos.protocol import Instruction
from hil.fakes.servos.servo import Servo

_BAUD_TOLERANCE = 0.03


def answers_most(servo: Servo) -> bool:
    """Whether a servo answers more than a ping."""
    return servo.table.get("status_return_level") >= 1


def reads_fast(servo: Servo) -> bool:
    """Whether a servo takes part in a fast read."""
    return servo.firmware >= servo.table.model.fast_read_firmware and answers_most(servo)


class Audience:
    """The servos of a bus by what they do with a packet.

    Args:
        options: which IDs are not connected.

    Attributes:
        servos: all, by joint; set by the bus.
        goals: the group write that came last, if all whom it concerns have taken goals there before.
    """

    def __init__(self, options: ServoBusOptions) -> None:
        self._absent = options.absent
        self.servos: Sequence[Servo] = ()
        self.forget()

    def forget(self) -> None:
        """Something has changed: find out again."""
        self._listeners: list[Servo] | None = None
        self._by_id: dict[int, list[Servo]] = {}
        self._motions: dict[bytes, MotionBlock] = {}
        self.goals: GoalBlock | None = None

    def listeners(self, baud: int, t_ns: int) -> list[Servo]:
        """Who hears what is sent now at a baud rate; another rate needs `forget` first."""
        if self._listeners is not None:
            return self._listeners
        low, high = 1.0 - _BAUD_TOLERANCE, 1.0 + _BAUD_TOLERANCE
        found = [
            s
            for s in self.servos
            if not s.dead
            and t_ns >= s.busy_until_ns
            and low * s.baud <= baud <= high * s.baud
            and s.id not in self._absent
        ]
        if all(t_ns >= s.busy_until_ns for s in self.servos):
            self._listeners = found
        return found

    def addressed(self, servo_id: int, listeners: list[Servo]) -> list[Servo]:
        """Which listeners take a part of a group write that is meant for an ID."""
        found = self._by_id.get(servo_id)
        if found is None:
            found = [s for s in listeners if servo_id in (s.id, s.secondary)]
            if self._listeners is not None:
                self._by_id[servo_id] = found
        return found

    def motion(self, instruction: Instruction) -> MotionBlock | None:
        """Servos that answer this fast sync read together, as `keep_motion` has found."""
        if instruction.code != protocol.FAST_SYNC_READ:
            return None
        return self._motions.get(instruction.parameters)

    def keep_motion(self, instruction: Instruction, wanted: Wanted) -> None:
        """Remember a read of current, velocity and position that all who were asked have answered."""
        able = [s for s in self._listeners or () if reads_fast(s)]
        by_id = {s.id: s for s in able}
        chain = [by_id[servo_id] for servo_id, _, _ in wanted if servo_id in by_id]
        rows = [s.table.layout.motion for s in chain]
        if (
            0 < len(chain) == len(wanted)
            and len(by_id) == len(able)
            and all(
                (row.address, row.size, row.form) == (address, length, FORM)
                for row, (_, address, length) in zip(rows, wanted, strict=True)
            )
        ):
            self._motions[instruction.parameters] = MotionBlock(chain, wanted)

    def keep_goals(self, instruction: Instruction, parts: Sequence[tuple[int, int, bytes]]) -> None:
        """Remember a group write of goals that servos with torque have taken, each its own part."""
        listeners = self._listeners
        if not parts or listeners is None or not all(s.torque for s in listeners):
            return
        taken = [(address, data, self.addressed(i, listeners)) for i, address, data in parts]
        takers = [s for _, _, servos in taken for s in servos]
        if len(set(map(id, takers))) == len(takers) and all(
            s.has_goal(address, data) for address, data, servos in taken for s in servos
        ):
            self.goals = GoalBlock(instruction, taken)
