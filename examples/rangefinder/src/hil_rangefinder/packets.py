"""The bytes on the wire: data packets of nine bytes, and commands with their answers.

Benewake TF-Luna product manual, appendices "Serial port output format" and "Serial communication protocol".
Driver and emulated sensor share this file; the packets printed in the manual are in its test.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

VERSION, RESET, RATE, TRIGGER, FORMAT = 0x01, 0x02, 0x03, 0x04, 0x05
BAUD, OUTPUT, RESTORE, SAVE, BAR_CODE = 0x06, 0x07, 0x10, 0x11, 0x12
CENTIMETRES, MILLIMETRES = 0x01, 0x06
WEAK, OVEREXPOSED = 100, 0xFFFF
"""Strengths below and at which a distance is not to be used."""

_DATA, _COMMAND = 0x59, 0x5A
_DATA_LENGTH, _SHORTEST, _LONGEST = 9, 4, 18
_BODY = struct.Struct("<2x3H")


class Reading(NamedTuple):
    """A data packet: distance in cm or mm as the sensor is set, strength in counts, temperature in C."""

    distance: int
    strength: int
    temperature_c: float


class Answer(NamedTuple):
    """What follows a command, in either direction: its number and its payload."""

    command: int
    payload: bytes


class Lost(NamedTuple):
    """Bytes that belong to no packet, after a packet that was whole."""


def data_packet(reading: Reading) -> bytes:
    """A reading as nine bytes."""
    raw = round((reading.temperature_c + 256.0) * 8.0)
    body = struct.pack("<2B3H", _DATA, _DATA, reading.distance, reading.strength, raw)
    return body + bytes((_sum(body),))


def command_packet(command: int, payload: bytes = b"") -> bytes:
    """A command, or the answer to it."""
    body = bytes((_COMMAND, _SHORTEST + len(payload), command)) + payload
    return body + bytes((_sum(body),))


def _sum(body: bytes) -> int:
    return sum(body) & 0xFF


class Packets:
    """Finds packets in a stream that may begin, break off and be spoilt anywhere."""

    def __init__(self) -> None:
        self._waiting = bytearray()
        self._in_step = False

    def feed(self, data: bytes) -> list[Reading | Answer | Lost]:
        """Take bytes; give what has become whole, and one `Lost` for each stretch that was not."""
        waiting, found = self._waiting, list[Reading | Answer | Lost]()
        waiting += data
        while len(waiting) >= 2:
            length = self._length()
            if length > len(waiting):
                break
            packet = bytes(waiting[:length])
            if packet and _sum(packet[:-1]) == packet[-1]:
                found.append(_read(packet))
                del waiting[:length]
                self._in_step = True
                continue
            if self._in_step:
                found.append(Lost())
                self._in_step = False
            del waiting[0]
        return found

    def _length(self) -> int:
        """Length of the packet that the waiting bytes may begin with; 0 where they cannot."""
        first, second = self._waiting[:2]
        if first == second == _DATA:
            return _DATA_LENGTH
        return second if first == _COMMAND and _SHORTEST <= second <= _LONGEST else 0


def _read(packet: bytes) -> Reading | Answer:
    if packet[0] == _COMMAND:
        return Answer(packet[2], packet[3:-1])
    distance, strength, raw = _BODY.unpack_from(packet)
    return Reading(distance, strength, raw / 8.0 - 256.0)
