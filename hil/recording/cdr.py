"""CDR encoding of the ROS 2 messages of every cycle: a stamp, texts that do not change, and numbers.

rosbags can write any message, but for these it would take more than half of a recording's time. The layout is
that of OMG's DDS-XTypes 1.3, 7.4.1 (XCDR version 1), little endian: a value begins at a multiple of its own
size, counted after the first four bytes.
"""

import struct
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from hil.core.geometry import Array

_ENCODING = b"\0\1\0\0"
_STAMP = struct.Struct("<iI")
_LENGTH, _LENGTHS = struct.Struct("<I"), struct.Struct("<3I")
_DOUBLE = 8

Stamp = tuple[int, int]
"""Seconds and nanoseconds of `builtin_interfaces/Time`."""


def clock(stamp: Stamp) -> bytes:
    """`rosgraph_msgs/Clock`."""
    return _ENCODING + _STAMP.pack(*stamp)


def octets(payload: bytes) -> bytes:
    """`std_msgs/UInt8MultiArray` with one unnamed dimension left out."""
    return _ENCODING + _LENGTHS.pack(0, 0, len(payload)) + payload


def transforms(stamp: Stamp, frames: Sequence[tuple[tuple[str, str], Sequence[float]]]) -> bytes:
    """`tf2_msgs/TFMessage`.

    Args:
        stamp: stamp of all transforms.
        frames: names (parent, child) and (7,): position in m, quaternion with w last.
    """
    data = _ENCODING + _LENGTH.pack(len(frames))
    for names, values in frames:
        data += _STAMP.pack(*stamp) + _texts(names)
        data += bytes(_gap(len(data))) + struct.pack("<7d", *values)
    return data


def stamped(stamp: Stamp, texts: tuple[str, ...], values: Sequence[float]) -> bytes:
    """A message that is a `std_msgs/Header`, perhaps further texts, and float64 values.

    Args:
        stamp: stamp of the header.
        texts: the header's frame, then the others.
        values: all numbers that follow, in their order.
    """
    begin = _ENCODING + _STAMP.pack(*stamp) + _texts(texts)
    return begin + bytes(_gap(len(begin))) + struct.pack(f"<{len(values)}d", *values)


def joint_state(stamp: Stamp, names: tuple[str, ...], columns: Iterable[Sequence[float] | Array]) -> bytes:
    """`sensor_msgs/JointState` without a frame.

    Args:
        stamp: stamp of the header.
        names: names of the joints.
        columns: positions, velocities and efforts, (n,) or (0,) each.
    """
    data = _ENCODING + _STAMP.pack(*stamp) + _names(names)
    for column in columns:
        data += _LENGTH.pack(len(column))
        if len(column):
            data += bytes(_gap(len(data))) + np.asarray(column, dtype="<f8").tobytes()
    return data


def _gap(length: int) -> int:
    """Padding up to the next place for a float64, bytes."""
    return (len(_ENCODING) - length) % _DOUBLE


def _text(text: str, data: bytes) -> bytes:
    """`data` with a text appended; the text begins at a multiple of four bytes."""
    encoded = text.encode() + b"\0"
    return data + bytes(-len(data) % _LENGTH.size) + _LENGTH.pack(len(encoded)) + encoded


@lru_cache(maxsize=64)
def _texts(texts: tuple[str, ...]) -> bytes:
    """Encode texts that follow a stamp."""
    data = b""
    for text in texts:
        data = _text(text, data)
    return data


@lru_cache(maxsize=64)
def _names(names: tuple[str, ...]) -> bytes:
    """Encode an empty frame and a sequence of names after a stamp, padded to the place of a length."""
    data = _text("", b"")
    data += bytes(-len(data) % _LENGTH.size) + _LENGTH.pack(len(names))
    for name in names:
        data = _text(name, data)
    return data + bytes(-len(data) % _LENGTH.size)
