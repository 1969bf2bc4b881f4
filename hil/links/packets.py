"""Finds packets and lines in a byte stream that may begin, end and be damaged anywhere."""

from collections.abc import Callable
from typing import Generic, TypeVar

P = TypeVar("P")


class PacketParser(Generic[P]):
    """Splits a byte stream into packets.

    Args:
        length: function to the length of the packet that a buffer of at least `head` bytes begins with; 0
            where it cannot begin one.
        decode: a packet of that many bytes; None where its checksum is wrong.
        head: bytes that `length` needs.
    """

    def __init__(
        self, length: Callable[[bytes], int], decode: Callable[[bytes], P | None], head: int
    ) -> None:
        self._length, self._decode, self._head = length, decode, head
        self._buffer = bytearray()
        self._in_step = False

    def feed(self, data: bytes) -> list[P | None]:
        """Packets that these bytes complete; one None for each damaged stretch after a whole packet."""
        self._buffer += data
        found: list[P | None] = []
        while len(self._buffer) >= self._head:
            length = self._length(bytes(self._buffer[: self._head]))
            if length > len(self._buffer):
                break
            packet = self._decode(bytes(self._buffer[:length])) if length else None
            if packet is not None:
                found.append(packet)
                del self._buffer[:length]
            else:
                if self._in_step:
                    found.append(None)
                del self._buffer[0]
            self._in_step = packet is not None
        return found


class LineParser:
    """Splits a byte stream into lines, without their ends.

    Args:
        longest: bytes of a line; a longer one is dropped.
    """

    def __init__(self, longest: int = 4096) -> None:
        self._rest, self._longest = b"", longest

    def feed(self, data: bytes) -> list[bytes]:
        """Lines that these bytes complete."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: self._longest + 2]
        stripped = (line.removesuffix(b"\r") for line in lines)
        return [line for line in stripped if len(line) <= self._longest]
