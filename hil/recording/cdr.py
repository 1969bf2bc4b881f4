"""CDR encoding of the ROS 2 messages of every cycle: a stamp, texts that do not change, and numbers.

rosbags can write any message, but for these it would take more than half of a recording's time. The layout is
that of OMG's DDS-XTypes 1.3, 7.4.1 (XCDR version 1), little endian: a value begins at a multiple of its own
size, counted after the first four bytes.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

_ENCODING = b"\0\1\0\0"
_STAMP = struct.Struct("<4siI")
_LENGTH, _OCTETS = struct.Struct("<I"), struct.Struct("<4s3I")
_DOUBLE = 8

Stamp = tuple[int, int]
"""Seconds and nanoseconds of `builtin_interfaces/Time`."""


def clock(stamp: Stamp) -> bytes:
    """`rosgraph_msgs/Clock`."""
    return _STAMP.pack(_ENCODING, *stamp)


def octets(payload: bytes) -> bytes:
    """`std_msgs/UInt8MultiArray` with one unnamed dimension left out."""
    return _OCTETS.pack(_ENCODING, 0, 0, len(payload)) + payload


def transforms(stamp: Stamp, frames: Sequence[tuple[tuple[str, str], Sequence[float]]]) -> bytes:
    """`tf2_msgs/TFMessage`.

    Args:
        stamp: stamp of all transforms.
        frames: names (parent, child) and (7,): position in m, quaternion with w last.
    """
    form, texts = _transforms(tuple(names for names, _ in frames))
    values: list[Any] = []
    for text, (_, numbers) in zip(texts, frames, strict=True):
        values += (*stamp, text, *numbers)
    return form.pack(_ENCODING, len(texts), *values)


def stamped(stamp: Stamp, texts: tuple[str, ...], values: Sequence[float]) -> bytes:
    """A message that is a `std_msgs/Header`, perhaps further texts, and float64 values.

    Args:
        stamp: stamp of the header.
        texts: the header's frame, then the others.
        values: all numbers that follow, in their order.
    """
    form, begin = _stamped(texts, len(values))
    return form.pack(_ENCODING, *stamp, begin, *values)


def joint_state(stamp: Stamp, names: tuple[str, ...], columns: Sequence[Sequence[float]]) -> bytes:
    """`sensor_msgs/JointState` without a frame.

    Args:
        stamp: stamp of the header.
        names: names of the joints.
        columns: positions, velocities and efforts, (n,) or (0,) each.
    """
    position, velocity, effort = columns
    lengths = len(position), len(velocity), len(effort)
    form, begin = _joint_state(names, lengths)
    n, m, k = lengths
    return form.pack(_ENCODING, *stamp, begin, n, *position, m, *velocity, k, *effort)


@lru_cache(maxsize=64)
def _transforms(names: tuple[tuple[str, str], ...]) -> tuple[struct.Struct, tuple[bytes, ...]]:
    """Form of transforms, and the encoded names of each."""
    form, texts = "<4sI", tuple(map(_texts, names))
    for text in texts:
        form = _with_doubles(f"{form}iI{len(text)}s", 7)
    return struct.Struct(form), texts


@lru_cache(maxsize=64)
def _stamped(texts: tuple[str, ...], count: int) -> tuple[struct.Struct, bytes]:
    """Form of a stamp, texts and that many float64 values, and the encoded texts."""
    encoded = _texts(texts)
    return struct.Struct(_with_doubles(f"<4siI{len(encoded)}s", count)), encoded


@lru_cache(maxsize=64)
def _joint_state(names: tuple[str, ...], lengths: tuple[int, ...]) -> tuple[struct.Struct, bytes]:
    """Form of joints with columns of these lengths, and the encoded empty frame and names."""
    encoded = _text("", b"")
    encoded += bytes(-len(encoded) % _LENGTH.size) + _LENGTH.pack(len(names))
    for name in names:
        encoded = _text(name, encoded)
    encoded += bytes(-len(encoded) % _LENGTH.size)
    form = f"<4siI{len(encoded)}s"
    for length in lengths:
        form = _with_doubles(f"{form}I", length)
    return struct.Struct(form), encoded


def _with_doubles(form: str, count: int) -> str:
    """A format with float64 values appended, which begin at a multiple of their size."""
    gap = (len(_ENCODING) - struct.calcsize(form)) % _DOUBLE
    return f"{form}{gap}x{count}d" if count else form


def _text(text: str, data: bytes) -> bytes:
    """`data` with a text appended; the text begins at a multiple of four bytes."""
    encoded = text.encode() + b"\0"
    return data + bytes(-len(data) % _LENGTH.size) + _LENGTH.pack(len(encoded)) + encoded


def _texts(texts: tuple[str, ...]) -> bytes:
    """Encode texts that follow a stamp."""
    data = b""
    for text in texts:
        data = _text(text, data)
    return data
