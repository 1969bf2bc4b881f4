"""The group write and the fast read of every cycle: eight servos as one block.

Both are looked at closely once. From then on, until a servo says that something has changed, the write is one
parse and a look at those goals that differ, and the reply to the read one loop without questions.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hil.fakes.servos import protocol
from hil.fakes.servos.group import Wanted
from hil.fakes.servos.position import HALF_WORD, WORD
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
        self._pack = struct.Struct("<" + "".join(f"2s{s.table.layout.motion.form}" for s in servos)).pack
        self._unpack = struct.Struct("".join(f"{2 + length}s" for _, _, length in wanted)).unpack
        self._members = [
            (s, s.axis.position, bytes((s.alert, s.id)), s.joint, s.axis.position.sign, s.axis.position.shift)
            for s in servos
        ]

    def reply(self, counts: list[int], velocities: list[int], currents: list[int]) -> bytes:
        """The whole reply; the servos sense what they show.

        Args:
            counts: (8,) encoders, by joint.
            velocities: (8,) in the servos' counts.
            currents: (8,) in the servos' counts.
        """
        values: list[bytes | int] = []
        for servo, position, head, j, sign, shift in self._members:
            encoder, velocity = counts[j], velocities[j]
            position.encoder, servo.velocity = encoder, velocity
            values += head, sign * currents[j], sign * velocity, (sign * encoder + shift) % WORD - HALF_WORD
        crc, tail, pieces = self._head_crc, b"", [self._head]
        for own in self._unpack(self._pack(*values)):
            piece = tail + own
            crc = checksum(piece, crc)
            tail = crc.to_bytes(2, "little")
            pieces.append(piece)
        pieces.append(tail)
        return b"".join(pieces)


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
        self._takers = [
            (2 * k + 1, address, servo, servo.axis.trajectory)
            for k, (address, _, servos) in enumerate(parts)
            for servo in servos
        ]

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
        for k, address, servo, trajectory in self._takers:
            goal, data = servo.goal, values[k]
            if goal is None or address != goal.address or data != goal.data or trajectory.ongoing:
                servo.write(address, data)
        return True
