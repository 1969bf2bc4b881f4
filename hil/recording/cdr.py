"""CDR, the encoding of ROS 2 messages, without ROS; and the messages that a device's samples become.

Written by hand because a general serialiser costs 26 us per message and these
run beside a control loop; the tests hold every byte against `rosbags`. Layout: OMG DDS-XTypes plain
CDR, little endian, primitives aligned to their size counted from after the four header bytes.
"""

from __future__ import annotations

import struct

import numpy as np

from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.geometry import Array

_HEADER = b"\x00\x01\x00\x00"
_U32, _F32, _TIME = struct.Struct("<I"), struct.Struct("<f"), struct.Struct("<iI")
_MAX_SECONDS = 2**31 - 1
NO_COVARIANCE = bytes(9 * 8)
"""Of three unknown variances."""


class CdrWriter:
    """Appends values with CDR alignment.

    Args:
        wall_ns: wall-clock time at the zero of the times that are written.
    """

    def __init__(self, wall_ns: int = 0) -> None:
        self._out = bytearray(_HEADER)
        self._wall_ns = wall_ns

    def align(self, size: int) -> None:
        """Pad to a multiple of `size`, counted from after the header."""
        self._out += bytes((4 - len(self._out)) % size)

    def u8(self, value: int) -> None:
        """One byte."""
        self._out.append(value)

    def u32(self, value: int) -> None:
        """Unsigned, four bytes."""
        self.align(4)
        self._out += _U32.pack(value)

    def f32(self, value: float) -> None:
        """Number, four bytes."""
        self.align(4)
        self._out += _F32.pack(value)

    def time(self, t_ns: int) -> None:
        """`builtin_interfaces/Time` of a time on the bench clock; clipped to what 32-bit seconds can say."""
        self.align(4)
        seconds, nanoseconds = divmod(max(0, t_ns + self._wall_ns), NS_PER_S)
        self._out += _TIME.pack(min(seconds, _MAX_SECONDS), nanoseconds)

    def text(self, value: str) -> None:
        """String with its terminating zero."""
        raw = value.encode("utf-8", "replace")
        self.u32(len(raw) + 1)
        self._out += raw
        self._out += b"\0"

    def header(self, t_ns: int, frame: str) -> None:
        """`std_msgs/Header`."""
        self.time(t_ns)
        self.text(frame)

    def doubles(self, *groups: bytes) -> None:
        """Fixed-size doubles given as their bytes."""
        self.align(8)
        for raw in groups:
            self._out += raw

    def sequence(self, values: Array) -> None:
        """`float64[]`."""
        self.u32(len(values))
        if len(values):
            self.doubles(raw(values))

    def octets(self, raw: bytes) -> None:
        """`uint8[]`."""
        self.u32(len(raw))
        self._out += raw

    def bytes(self) -> bytes:
        """The message."""
        return bytes(self._out)


def raw(values: Array) -> bytes:
    """Doubles as bytes."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def xyzw(q_wxyz: Array) -> bytes:
    """A quaternion in the order of ROS."""
    return raw(np.roll(q_wxyz, -1))


def octet_array(payload: bytes) -> bytes:
    """`std_msgs/UInt8MultiArray` with one unnamed dimension left out."""
    cdr = CdrWriter()
    cdr.u32(0)
    cdr.u32(0)
    cdr.octets(payload)
    return cdr.bytes()


def octets_of(message: bytes) -> bytes:
    """Payload of a message made by `octet_array`.

    Raises:
        ValueError: another layout, or shorter than it says.
    """
    if len(message) < 16 or message[:4] != _HEADER or any(message[4:8]):
        raise ValueError("not a byte array as written by this project")
    payload = message[16 : 16 + _U32.unpack_from(message, 12)[0]]
    if len(payload) != _U32.unpack_from(message, 12)[0]:
        raise ValueError("byte array shorter than it says")
    return payload


def string(value: str) -> bytes:
    """`std_msgs/String`."""
    cdr = CdrWriter()
    cdr.text(value)
    return cdr.bytes()


def text_of(message: bytes) -> str:
    """Text of a `std_msgs/String`.

    Raises:
        ValueError: shorter than it says.
    """
    if len(message) < 9:
        raise ValueError("string message too short")
    length = _U32.unpack_from(message, 4)[0]
    if length < 1 or len(message) < 8 + length:
        raise ValueError("string shorter than it says")
    return message[8 : 7 + length].decode("utf-8", "replace")


def joints(t_ns: int, names: tuple[str, ...], values: tuple[Array, ...], wall_ns: int) -> bytes:
    """`sensor_msgs/JointState`; `values` are positions, velocities and efforts."""
    cdr = CdrWriter(wall_ns)
    cdr.header(t_ns, "")
    cdr.u32(len(names))
    for name in names:
        cdr.text(name)
    for column in values:
        cdr.sequence(column)
    return cdr.bytes()


def pose_stamped(t_ns: int, frame: str, position_m: Array, quaternion_wxyz: Array, wall_ns: int = 0) -> bytes:
    """`geometry_msgs/PoseStamped`."""
    cdr = CdrWriter(wall_ns)
    cdr.header(t_ns, frame)
    cdr.doubles(raw(position_m), xyzw(quaternion_wxyz))
    return cdr.bytes()
