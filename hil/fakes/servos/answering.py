"""The fast reply of the servos to the read of every cycle, in flat vectors (`hil.vocabulary.arithmetic`).

Each servo writes its piece behind those of the others: alert, ID, current, velocity, position, and a checksum
that covers all bytes before it.
"""

from __future__ import annotations

from hil.fakes.servos.counting import SHOWN_COUNTS, SHOWN_CURRENTS, SHOWN_VELOCITIES
from hil.vocabulary.arithmetic import Octets, Row, Rows

FORM = "hii"
"""Of current, velocity and position, as `struct` has it."""

# What is known of a servo (5,): its joint, direction, what its position adds to the encoder, alert and ID.
JOINT, SIGN, SHIFT, ALERT, ID = range(5)


def answer(shown: Rows, servos: Rows, crcs: Row, crc: int, at: int, reply: Octets) -> None:
    """Write the pieces of all servos.

    Args:
        shown: (3, 8) encoders, velocities and currents in the servos' counts, by joint.
        servos: (n, 5) in the order asked.
        crcs: (256,) checksums of each byte alone.
        crc: checksum of the head.
        at: bytes of the head, which is there already.
        reply: the bytes.
    """
    covered = at
    for k in range(len(servos)):
        servo = servos[k]
        j, sign = servo[JOINT], servo[SIGN]
        reply[at], reply[at + 1] = servo[ALERT], servo[ID]
        at = write(reply, at + 2, sign * shown[SHOWN_CURRENTS][j], 2)
        at = write(reply, at, sign * shown[SHOWN_VELOCITIES][j], 4)
        at = write(reply, at, sign * shown[SHOWN_COUNTS][j] + servo[SHIFT], 4)
        for i in range(covered, at):
            crc = (crc << 8 & 0xFFFF) ^ crcs[crc >> 8 ^ reply[i]]
        covered, at = at, write(reply, at, crc, 2)


def write(reply: Octets, at: int, number: int, size: int) -> int:
    """Write the lowest `size` bytes of a number, little end first; where the next one begins."""
    for k in range(size):
        reply[at + k] = number >> 8 * k & 0xFF
    return at + size
