"""Reads a payload from front to back; raises `MalformedPacket` for a step beyond its end."""

import struct
from typing import Any

from hil.drivers.mocap.natnet.packets import MalformedPacket

_INT = struct.Struct("<i")


class Cursor:
    """A position in a payload; every step is checked, so that garbage costs neither time nor memory."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes that have not been read."""
        return len(self.data) - self.at

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Fields of a fixed layout."""
        start = self.at
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def skip(self, size: int) -> None:
        """Pass over `size` bytes."""
        if not 0 <= size <= self.left:
            raise MalformedPacket(f"{size} bytes wanted where {self.left} are left")
        self.at += size

    def integer(self) -> int:
        """A signed 32-bit integer."""
        value: int = self.take(_INT)[0]
        return value

    def count(self, least_size: int) -> int:
        """A number of items, checked against the bytes left for items of `least_size` bytes or more."""
        value = self.integer()
        if not 0 <= value * least_size <= self.left:
            raise MalformedPacket(f"{value} items announced where {self.left} bytes are left")
        return value

    def text(self) -> str:
        """A string that ends with zero."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise MalformedPacket("a name has no end")
        raw, self.at = self.data[self.at : end], end + 1
        return raw.decode("utf-8", "replace")
