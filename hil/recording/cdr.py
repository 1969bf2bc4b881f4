"""CDR, the encoding of ROS 2 messages, without ROS; and the messages that a device's samples become.

Written by hand because a general serialiser costs 26 us per message and these
run beside a control loop; the tests hold every byte against `rosbags`. Layout: OMG DDS-XTypes plain
CDR, little endian, primitives aligned to their size counted from after the four header bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.geometry import Array

_HEADER = b"\x00\x01\x00\x00"
_U32, _F32, _TIME, _THREE = (struct.Struct(form) for form in ("<I", "<f", "<iI", "<3I"))
_MAX_SECONDS = 2**31 - 1
_LATEST_NS = (_MAX_SECONDS + 1) * NS_PER_S
NO_COVARIANCE = (0.0,) * 9
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
        self._out += _TIME.pack(*_seconds(t_ns + self._wall_ns))

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
        """`float64[]` of an array of any shape."""
        self.u32(len(values))
        if len(values):
            self.doubles(np.ascontiguousarray(values, dtype="<f8").tobytes())

    def raw(self, raw: bytes) -> None:
        """Bytes as they are."""
        self._out += raw

    def bytes(self) -> bytes:
        """The message."""
        return bytes(self._out)


class Doubles(NamedTuple):
    """Numbers of eight bytes, in a `CdrForm`.

    Attributes:
        number: how many the message has.
        places: of those that are given, in rising order; the others are zero. None: all are given.
    """

    number: int
    places: tuple[int, ...] | None = None


TIME = None
"""Where a `CdrForm` has the time of its message."""


class CdrForm:
    """A message of texts and lengths that never change; only time and numbers are filled in, in one step.

    Args:
        parts: in order: `TIME`, a text, an unsigned number of four bytes, or `Doubles`.

    Attributes:
        pack: makes the message of its time on the bench clock (ns), wall-clock time at the zero of that clock
            (ns), and a sequence of numbers for each `Doubles`.
    """

    def __init__(self, *parts: str | int | Doubles | None) -> None:
        cdr, form = CdrWriter(), ["<"]
        fixed: list[bytes] = []
        values: list[str] = []
        groups: list[str] = []
        begun = 0

        def fill(code: str, values_of_it: tuple[str, ...], size: int) -> None:
            """What has been written since the last time or number stays as it is, then comes a value."""
            nonlocal begun
            if len(cdr.bytes()) > begun:
                fixed.append(cdr.bytes()[begun:])
                form.append(f"{len(fixed[-1])}s")
                values.append(f"fixed_{len(fixed)}")
            form.append(code)
            values.extend(values_of_it)
            cdr.raw(bytes(size))
            begun = len(cdr.bytes())

        for part in parts:
            if isinstance(part, str):
                cdr.text(part)
            elif isinstance(part, int):
                cdr.u32(part)
            elif part is TIME:
                cdr.align(4)
                fill("iI", ("seconds", "nanoseconds"), _TIME.size)
            else:
                groups.append(f"numbers_{len(groups)}")
                if part.number:
                    cdr.align(8)
                    fill(_code(part), (f"*{groups[-1]}",), 8 * part.number)
        fill("", (), 0)
        source = (
            f"def pack({', '.join(('t_ns', 'wall_ns', *groups))}):\n"
            " t_ns += wall_ns\n"
            " seconds, nanoseconds = divmod(t_ns, second) if 0 <= t_ns < latest else clipped(t_ns)\n"
            f" return pack_all({', '.join(values)})"
        )
        self.pack = _packing(source, struct.Struct("".join(form)), fixed)


def _code(part: Doubles) -> str:
    """Code in `struct` of numbers, with padding, which is zero, where none is given."""
    if part.places is None:
        return f"{part.number}d"
    given = ["d" if place in part.places else "8x" for place in range(part.number)]
    return "".join(given)


def _packing(source: str, layout: struct.Struct, fixed: list[bytes]) -> Callable[..., bytes]:
    """The function `pack` of a form, from its source."""
    scope: dict[str, Any] = {f"fixed_{number}": raw for number, raw in enumerate(fixed, start=1)}
    scope |= {"second": NS_PER_S, "latest": _LATEST_NS, "clipped": _seconds, "pack_all": layout.pack}
    exec(source, scope)  # as `dataclasses` does
    pack: Callable[..., bytes] = scope["pack"]
    return pack


def _seconds(t_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a time; clipped to what 32-bit seconds can say."""
    if 0 <= t_ns < _LATEST_NS:
        return divmod(t_ns, NS_PER_S)
    return (0, 0) if t_ns < 0 else (_MAX_SECONDS, t_ns % NS_PER_S)


def xyzw(q_wxyz: Array) -> tuple[float, float, float, float]:
    """A quaternion (4,), w first, in the order of ROS."""
    w, x, y, z = q_wxyz.tolist()
    return x, y, z, w


def octet_array(payload: bytes) -> bytes:
    """`std_msgs/UInt8MultiArray` with one unnamed dimension left out."""
    return _HEADER + _THREE.pack(0, 0, len(payload)) + payload


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


def joints(
    t_ns: int, names: tuple[str, ...], values: tuple[Array | tuple[float, ...], ...], wall_ns: int
) -> bytes:
    """`sensor_msgs/JointState`; `values` are positions, velocities and efforts, (n,) each."""
    at, rate, effort = [column if isinstance(column, tuple) else column.tolist() for column in values]
    return _joint_form(names, len(at), len(rate), len(effort)).pack(t_ns, wall_ns, at, rate, effort)


@lru_cache(maxsize=64)
def _joint_form(names: tuple[str, ...], *lengths: int) -> CdrForm:
    columns: list[int | Doubles] = []
    for length in lengths:
        columns += (length, Doubles(length))
    return CdrForm(TIME, "", len(names), *names, *columns)


def pose_stamped(t_ns: int, frame: str, position_m: Array, quaternion_wxyz: Array, wall_ns: int = 0) -> bytes:
    """`geometry_msgs/PoseStamped` of a position (3,) m and a quaternion (4,)."""
    w, x, y, z = quaternion_wxyz.tolist()
    return _pose_form(frame).pack(t_ns, wall_ns, (*position_m.tolist(), x, y, z, w))


@lru_cache(maxsize=64)
def _pose_form(frame: str) -> CdrForm:
    return CdrForm(TIME, frame, Doubles(7))
