"""Protocol 2.0 on the side of a servo: finds instruction packets in a byte stream, builds replies.

Written from the vendor's description and checked with its test vectors (ROBOTIS e-manual, Protocol 2.0); the
driver shares no code with it.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from fastcrc import crc16

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE

PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
FACTORY_RESET, REBOOT, CLEAR, BACKUP, STATUS = 0x06, 0x08, 0x10, 0x20, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A

_READS = (SYNC_READ, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ)

OK, RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR = 0, 1, 2, 3
DATA_RANGE, DATA_LENGTH, DATA_LIMIT, ACCESS = 4, 5, 6, 7
ALERT = 0x80

BYTE_GAP_NS = 1_500_000
_OVERHEAD = 7
_SHORTEST, _LONGEST = 3, 1024


class Instruction(NamedTuple):
    """One instruction packet; `sound`: whether its checksum is correct."""

    servo_id: int
    code: int
    parameters: bytes
    sound: bool = True


checksum: Callable[..., int] = crc16.umts
"""CRC-16 of bytes with polynomial 0x8005; the second argument is a checksum to continue."""


def stuff(body: bytes) -> bytes:
    """Insert an extra FD after every FF FF FD, so that no header appears inside a packet."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Inverse of `stuff`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def packet(servo_id: int, body: bytes) -> bytes:
    """Build a packet: header, ID, length, stuffed body (instruction first) and checksum."""
    body = stuff(body)
    data = HEADER + bytes((servo_id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return data + checksum(data).to_bytes(2, "little")


def status(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """Build a status packet."""
    return packet(servo_id, bytes((STATUS, error)) + parameters)


def fast_status(parts: list[tuple[int, int, bytes]], declared: int) -> list[bytes]:
    """Build the pieces of a fast read's reply, one per servo (ID, error, data); the first has the header.

    The pieces are not stuffed, and every checksum covers all bytes before it.

    Args:
        parts: replying servos, in order.
        declared: length in the header: instruction and pieces of all addressed servos, bytes.
    """
    head = HEADER + bytes((BROADCAST,)) + (declared & 0xFFFF).to_bytes(2, "little") + bytes((STATUS,))
    pieces = []
    crc, uncounted = 0, head
    for servo_id, error, data in parts:
        chunk = bytes((error, servo_id)) + data
        crc = checksum(uncounted + chunk, crc)
        uncounted = crc.to_bytes(2, "little")
        pieces.append(head + chunk + uncounted)
        head = b""
    return pieces


def mixed(packets: Sequence[bytes]) -> bytes:
    """Return the bytes on a line that several servos drive at once, slightly out of step."""
    line = bytearray(b"\xff" * max(map(len, packets)))
    for shift, data in enumerate(packets):
        for k, byte in enumerate(data):
            line[k] &= byte >> shift & 0xFF
    return bytes(line)


class InstructionParser:
    """Finds instruction packets in a stream that may contain noise and fragments.

    A pause of more than 1.5 ms between bytes makes the servos wait for a new header. The latest read is
    cached, because every cycle requests the same read.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._last_ns = 0
        self._read: tuple[bytes, list[Instruction]] = (b"", [])

    def reset(self) -> None:
        """Discard the data received so far."""
        self._buffer.clear()

    def feed(self, data: bytes, first_ns: int, last_ns: int) -> list[Instruction]:
        """Return the complete packets after `data`, whose bytes arrived from `first_ns` to `last_ns`."""
        if first_ns - self._last_ns > BYTE_GAP_NS:
            self._buffer.clear()
        self._last_ns = last_ns
        if not self._buffer and data:
            if data == self._read[0]:
                return self._read[1]
            if (whole := _whole(data)) is not None:
                if whole.code in _READS:
                    self._read = (data, [whole])
                return [whole]
        self._buffer += data
        found = []
        while (one := self._next()) is not None:
            found.append(one)
        return found

    def _next(self) -> Instruction | None:
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                del buffer[: max(0, len(buffer) - 3)]
                return None
            del buffer[:start]
            if len(buffer) < _OVERHEAD:
                return None
            length = buffer[5] | buffer[6] << 8
            if not _SHORTEST <= length <= _LONGEST:
                del buffer[:4]
                continue
            end = _OVERHEAD + length
            if len(buffer) < end:
                return None
            data = bytes(buffer[:end])
            sound = checksum(data[:-2]) == data[-2] | data[-1] << 8
            del buffer[: end if sound else 4]
            if data[7] == STATUS:
                continue
            return Instruction(data[4], data[7], unstuff(data[8:-2]), sound)


def _whole(data: bytes) -> Instruction | None:
    """Return the instruction if the bytes are exactly one valid instruction packet, else None."""
    if len(data) < _OVERHEAD + _SHORTEST or not data.startswith(HEADER):
        return None
    length = data[5] | data[6] << 8
    if length > _LONGEST or len(data) != _OVERHEAD + length or data[7] == STATUS:
        return None
    if checksum(data[:-2]) != data[-2] | data[-1] << 8:
        return None
    return Instruction(data[4], data[7], unstuff(data[8:-2]), True)
