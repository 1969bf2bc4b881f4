"""Where one message ends and the next begins in the bytes of a device, by protocol."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

_NEEDS_MORE = -1


class Framing(NamedTuple):
    """How the messages of a protocol are told apart.

    Attributes:
        head: number of bytes from which `length` knows the length.
        length: length of the message that begins with these bytes; 0 where none begins, -1 where more bytes
            are needed.
    """

    head: int
    length: Callable[[bytearray], int]


def messages(framing: Framing | None, buffer: bytearray) -> Iterator[bytes]:
    """Take the complete messages out of a buffer, in order; the rest stays in it.

    Bytes that begin no message are passed on together, up to the next message.

    Args:
        framing: framing of the device; None where whatever arrives at once is one message.
        buffer: bytes that have arrived.
    """
    if framing is None:
        if buffer:
            yield bytes(buffer)
            buffer.clear()
        return
    strays = bytearray()
    while len(buffer) >= framing.head:
        length = framing.length(buffer)
        if length == 0:
            strays.append(buffer.pop(0))
            continue
        if length < 0 or length > len(buffer):
            break
        if strays:
            yield bytes(strays)
            strays.clear()
        yield bytes(buffer[:length])
        del buffer[:length]
    if strays:
        yield bytes(strays)


def _dynamixel(b: bytearray) -> int:
    return 7 + (b[5] | b[6] << 8) if b[:4] == b"\xff\xff\xfd\x00" else 0


def _bno055(b: bytearray) -> int:
    return 2 if b[0] == 0xEE else 2 + b[1] if b[0] == 0xBB else 0


def _mip(b: bytearray) -> int:
    return 6 + b[3] if b[:2] == b"\x75\x65" else 0


def _mavlink(b: bytearray) -> int:
    if b[0] == 0xFE:
        return 8 + b[1]
    return 12 + b[1] + 13 * (b[2] & 1) if b[0] == 0xFD else 0


def _line(b: bytearray) -> int:
    return b.find(b"\n") + 1 or _NEEDS_MORE


FRAMINGS: Mapping[str, Framing] = {
    "dynamixel": Framing(7, _dynamixel),
    "bno055": Framing(2, _bno055),
    "mip": Framing(4, _mip),
    "mavlink": Framing(3, _mavlink),
    "line": Framing(1, _line),
}
"""Framing by protocol: Dynamixel Protocol 2.0, BNO055 UART, MIP, MAVLink 1 and 2, lines of text."""
