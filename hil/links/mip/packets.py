"""The MIP framing of MicroStrain sensors, both ways: packets of fields with a Fletcher checksum.

A packet is `75 65 SET LENGTH fields CHECKSUM`, a field `LENGTH DESCRIPTOR data`, where the field's length
counts its own two bytes and the packet's does not; numbers are big endian (MIP protocol, MIP SDK manual).
"""

from collections.abc import Iterable
from itertools import accumulate
from typing import NamedTuple

SYNC = b"\x75\x65"
HEAD_BYTES, CHECKSUM_BYTES = 4, 2
LARGEST_PAYLOAD = 255
LARGEST_BYTES = HEAD_BYTES + LARGEST_PAYLOAD + CHECKSUM_BYTES
FIELD_HEAD_BYTES = 2


class Field(NamedTuple):
    """One field: its descriptor, and its bytes without the two of its head."""

    descriptor: int
    data: bytes = b""


class Packet(NamedTuple):
    """Fields of one descriptor set: a command, its reply, or one set of measurements."""

    descriptor_set: int
    fields: tuple[Field, ...]


def checksum(data: bytes) -> bytes:
    """Fletcher's two sums, each modulo 256, over everything from the sync bytes on."""
    sums = tuple(accumulate(data))
    return bytes(((sums[-1] if sums else 0) & 0xFF, sum(sums) & 0xFF))


def payload_bytes(fields: Iterable[Field]) -> int:
    """How many bytes of a packet these fields take."""
    return sum(FIELD_HEAD_BYTES + len(data) for _, data in fields)


def encode(descriptor_set: int, fields: Iterable[Field]) -> bytes:
    """A packet as it goes over the wire.

    Raises:
        ValueError: the fields do not fit into one packet.
    """
    payload = b"".join(
        bytes((FIELD_HEAD_BYTES + len(data), descriptor)) + data for descriptor, data in fields
    )
    if len(payload) > LARGEST_PAYLOAD:
        raise ValueError(f"{len(payload)} bytes of fields do not fit into a packet of {LARGEST_PAYLOAD}")
    frame = SYNC + bytes((descriptor_set, len(payload))) + payload
    return frame + checksum(frame)


def cut(payload: bytes) -> tuple[Field, ...] | None:
    """Split a payload into fields; None when they do not fill it exactly."""
    fields: list[Field] = []
    at = 0
    while at < len(payload):
        length = payload[at]
        if length < FIELD_HEAD_BYTES or at + length > len(payload):
            return None
        fields.append(Field(payload[at + 1], payload[at + FIELD_HEAD_BYTES : at + length]))
        at += length
    return tuple(fields)


class PacketParser:
    """Splits a byte stream into packets; never raises, keeps at most one unfinished packet.

    Args:
        patience_ns: longest time for the rest of a packet. A spoilt length byte would otherwise hold back the
            packets that follow until 255 bytes have come.

    Attributes:
        rejected: stretches of bytes that were spoilt on the way: what begins as a packet and is none. What
            looks like the begin of another one within it, until a whole packet is found, is the same stretch.
        skipped: bytes that belong to no packet.
    """

    def __init__(self, patience_ns: int) -> None:
        self._patience_ns = patience_ns
        self.rejected = self.skipped = 0
        self.reset()

    def reset(self) -> None:
        """Forget an unfinished packet."""
        self._buffer = bytearray()
        self._since_ns = self._spoilt = 0

    def feed(self, data: bytes, t_ns: int) -> list[Packet]:
        """The packets that `data`, received at `t_ns`, completes."""
        buffer = self._buffer
        if not buffer:
            self._since_ns = t_ns
        buffer += data
        found: list[Packet] = []
        while self._aligned():
            length = HEAD_BYTES + buffer[3] + CHECKSUM_BYTES
            if len(buffer) >= length:
                found += self._take(length)
            elif t_ns - self._since_ns > self._patience_ns:
                self._reject(len(buffer))
            else:
                break
            self._since_ns = t_ns
        return found

    def _take(self, length: int) -> tuple[Packet, ...]:
        frame = bytes(self._buffer[:length])
        fields = None
        if checksum(frame[:-CHECKSUM_BYTES]) == frame[-CHECKSUM_BYTES:]:
            fields = cut(frame[HEAD_BYTES:-CHECKSUM_BYTES])
        if fields is None:
            self._reject(length)
            return ()
        self._spoilt = 0
        del self._buffer[:length]
        return (Packet(frame[2], fields),)

    def _reject(self, length: int) -> None:
        """Count this stretch as rejected, once, and go on searching behind its sync bytes."""
        if not self._spoilt:
            self.rejected += 1
            self._spoilt = length
        self._drop(len(SYNC))

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._spoilt = max(0, self._spoilt - count)

    def _aligned(self) -> bool:
        """Discard bytes before the next sync bytes; True once a whole head has arrived."""
        buffer = self._buffer
        at = buffer.find(SYNC)
        if at < 0:
            at = len(buffer) - (buffer[-1:] == SYNC[:1])
        self.skipped += at
        self._drop(at)
        return len(buffer) >= HEAD_BYTES
