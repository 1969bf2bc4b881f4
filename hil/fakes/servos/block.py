"""The group write and the fast read of every cycle: eight servos as one block.

Both are looked at closely once. From then on, until a servo says that something has changed, the write is one
parse and a look at those goals that differ, and the reply to the read one loop without questions.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from hil.fakes.servos import protocol
from hil.fakes.servos.answering import answer
from hil.fakes.servos.group import Wanted
from hil.fakes.servos.position import HALF_WORD
from hil.fakes.servos.protocol import Instruction, checksum
from hil.fakes.servos.servo import Servo
from hil.vocabulary.arithmetic import Rows, octets, quick, rows


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
        size = sum(length + 4 for _, _, length in wanted)
        head = protocol.fast_head(1 + size)
        self._head_crc, self._begins = checksum(head), len(head)
        self._reply = octets(head + bytes(size))
        self._bytes = memoryview(self._reply)
        self._members = [(s, s.axis.position, s.joint) for s in servos]
        known = [(s.joint, p.sign, p.shift - HALF_WORD, s.alert, s.id) for s, p, _ in self._members]
        self._known = rows(np.array(known, dtype=np.int64))
        self._crcs = rows(_crcs())
        self._answer = answering()

    def reply(self, shown: Rows, listed: Sequence[Sequence[int]]) -> bytes:
        """The whole reply; the servos sense what they show.

        Args:
            shown: (3, 8) encoders, velocities and currents in the servos' counts, by joint.
            listed: the same as lists.
        """
        counts, velocities, _ = listed
        for servo, position, j in self._members:
            position.encoder, servo.velocity = counts[j], velocities[j]
        self._answer(shown, self._known, self._crcs, self._head_crc, self._begins, self._reply)
        return self._bytes.tobytes()


def answering() -> Callable[..., None]:
    """`answer`, compiled if it can be; an emulated bus has it loaded before anybody waits for an answer."""
    block: np.ndarray = np.zeros((3, 8), dtype=np.int64)
    return quick(answer, rows(block), rows(block), rows(block[0]), 0, 0, octets(b"\0"))


@cache
def _crcs() -> np.ndarray:
    """Checksums (256,) of each byte alone."""
    return np.array([checksum(bytes((k,))) for k in range(256)], dtype=np.int64)


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
            if (
                goal is None
                or address != goal.address
                or ((data != goal.data or trajectory.ongoing) and not servo.rewrite(goal, data))
            ):
                servo.write(address, data)
        return True
