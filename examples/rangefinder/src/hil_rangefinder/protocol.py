"""TF-Luna on the wire (product manual, appendices): nine-byte data packets, commands and their answers.

Driver and emulated sensor share this file; the packets printed in the manual are in its test.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from hil.devkit.driver import PacketParser

VERSION, RESET, RATE, TRIGGER, FORMAT, BAUD, OUTPUT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07
RESTORE, SAVE, BAR_CODE = 0x10, 0x11, 0x12
UNITS = {"cm": (b"\x01", 0.01), "mm": (b"\x06", 0.001)}
"""Payload of `FORMAT`, and metres per count."""
RATES_HZ = frozenset(500 // n for n in range(2, 501))
WEAK, OVEREXPOSED = 100, 0xFFFF
"""Strengths below and at which a distance is not to be used."""
_HEADER, _COMMAND, _DATA_LENGTH, _SHORTEST, _LONGEST = 0x59, 0x5A, 9, 4, 18


class Reading(NamedTuple):
    """A data packet: distance in cm or mm as the sensor is set, strength in counts, temperature in C."""

    distance: int
    strength: int
    temperature_c: float

    def packet(self) -> bytes:
        """As nine bytes."""
        raw = round((self.temperature_c + 256.0) * 8.0)
        return _with_sum(struct.pack("<2B3H", _HEADER, _HEADER, self.distance, self.strength, raw))


class Command(NamedTuple):
    """A command, or the answer to it."""

    code: int
    payload: bytes = b""

    def packet(self) -> bytes:
        """As bytes."""
        return _with_sum(bytes((_COMMAND, _SHORTEST + len(self.payload), self.code)) + self.payload)


def parser() -> PacketParser[Reading | Command]:
    """Finds data packets, commands and answers in a stream."""
    return PacketParser(_length, _decode, head=2)


def is_possible(code: int, payload: bytes) -> bool:
    """Whether a setting may have this value."""
    value = int.from_bytes(payload, "little")
    numbers = {RATE: {0, *RATES_HZ}, BAUD: range(9_600, 921_601), OUTPUT: (0, 1)}
    return value in numbers[code] if code in numbers else payload in dict(UNITS.values())


def _with_sum(body: bytes) -> bytes:
    return body + bytes((sum(body) & 0xFF,))


def _length(head: bytes) -> int:
    if head[0] == head[1] == _HEADER:
        return _DATA_LENGTH
    return head[1] if head[0] == _COMMAND and _SHORTEST <= head[1] <= _LONGEST else 0


def _decode(packet: bytes) -> Reading | Command | None:
    if sum(packet[:-1]) & 0xFF != packet[-1]:
        return None
    if packet[0] == _COMMAND:
        return Command(packet[2], packet[3:-1])
    distance, strength, raw = struct.unpack_from("<3H", packet, 2)
    return Reading(distance, strength, raw / 8.0 - 256.0)
