"""The group write and the fast read of every cycle: eight servos as one block.

Both are looked at closely once. From then on, until a servo says that something has changed, the write is one
parse and a look at those goals that differ, and the reply to the read one loop without questions.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hil.fakes.servos import protocol
from hil.fakes.servos.group import Wanted
from hil.fakes.servos.protocol import Instruction, checksum
from hil.fakes.servos.servo import Servo


class MotionBlock:
    """Servos that answer one and the same fast sync read of current, velocity and position together.

    Args:
        servos: in the order asked.
        wanted: what was asked.

    Attributes:
        delay_ns: return delay of the slowest.
    """

    def __init__(self, servos: Sequence[Servo], wanted: Wanted) -> None:
        self.delay_ns = max(s.delay_ns for s in servos)
        self._head = protocol.fast_head(1 + sum(length + 4 for _, _, length in wanted))
        self._head_crc = checksum(self._head)
        self._members = [(s, bytes((s.alert, s.id)), s.table.layout.motion.pack, s.joint) for s in servos]

    def reply(self, counts: list[int], velocities: list[int], currents: list[int]) -> bytes:
        """The whole reply; the servos sense what they show.

        Args:
            counts: (8,) encoders, by joint.
            velocities: (8,) in the servos' counts.
            currents: (8,) in the servos' counts.
        """
        reply, crc, tail = self._head, self._head_crc, b""
        for servo, head, pack, j in self._members:
            piece = head + pack(*servo.motion(counts[j], velocities[j], currents[j]))
            crc = checksum(tail + piece, crc)
            tail = crc.to_bytes(2, "little")
            reply += piece + tail
        return reply


class GoalBlock:
    """A group write that all driven servos have heard: who takes which part of it.

    Args:
        instruction: the write, as it came.
        parts: (address, data, servos that take it), in order.
    """

    def __init__(self, instruction: Instruction, parts: Sequence[tuple[int, bytes, Sequence[Servo]]]) -> None:
        self._code, form = instruction.code, ["<"]
        first, more = (5, 1) if self._code == protocol.SYNC_WRITE else (5, 5)
        for k, (_, data, _) in enumerate(parts):
            form.append(f"{more if k else first}s{len(data)}s")
        rest = len(instruction.parameters) - struct.calcsize("".join(form))  # a part that is cut off
        self._form = struct.Struct("".join(form) + f"{rest}x")
        self._heads = self._form.unpack(instruction.parameters)[::2]
        self._takers = [(address, servos) for address, _, servos in parts]

    def write(self, instruction: Instruction) -> bool:
        """Take another write of the same shape; False for any other."""
        parameters = instruction.parameters
        if instruction.code != self._code or instruction.servo_id != protocol.BROADCAST:
            return False
        if len(parameters) != self._form.size:
            return False
        values = self._form.unpack(parameters)
        if values[::2] != self._heads:
            return False
        for (address, servos), data in zip(self._takers, values[1::2], strict=True):
            for servo in servos:
                servo.write_goal(address, data)
        return True
