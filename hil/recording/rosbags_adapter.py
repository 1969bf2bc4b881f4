"""ROS 2 messages by the classes of the package rosbags: made, written as CDR, and read again.

Importing this module loads rosbags, which takes some tenths of a second: a recorder imports it in its writer
thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import compress
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros2_humble import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Quaternion as Quaternion
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_humble import std_msgs__msg__Header as Header

from hil.core.clock import NS_PER_S
from hil.core.errors import ConfigError
from hil.core.geometry import Array
from hil.recording import cdr

_STORE: Any = get_typestore(Stores.ROS2_HUMBLE)
_LATEST_NS = 2**31 * NS_PER_S - 1


def to_cdr(given: Any) -> bytes:
    """A message as CDR, little endian; bytes count as CDR and are returned unchanged."""
    return given if isinstance(given, bytes) else bytes(_STORE.serialize_cdr(given, given.__msgtype__))


def from_cdr(data: bytes, kind: str) -> Any:
    """The message of a type that CDR bytes hold.

    Raises:
        ValueError: the bytes are no such message.
    """
    try:
        return _STORE.deserialize_cdr(data, kind)
    except Exception as error:  # whatever the generated code makes of bytes that are no message
        raise ValueError(f"no {kind} ({error})") from None


def pose_numbers(position_m: Sequence[float] | Array, q_wxyz: Sequence[float] | Array) -> tuple[float, ...]:
    """(7,) of a pose as ROS 2 orders it: position m, quaternion with w last.

    Args:
        position_m: position (3,).
        q_wxyz: quaternion (4,), w first.
    """
    w, x, y, z = _floats(q_wxyz)
    return (*_floats(position_m), x, y, z, w)


def definition(kind: str) -> str:
    """Definition of a message type with those of its parts.

    Raises:
        ConfigError: ROS 2 has no such type.
    """
    try:
        found: str = _STORE.generate_msgdef(kind, ros_version=2)[0]
    except Exception as error:
        raise ConfigError(f"message type {kind!r} cannot be recorded ({error})") from error
    return found


class MessageMaker:
    """Makes messages whose stamps are wall-clock time, and their usual parts.

    Args:
        wall_ns: wall-clock time at the bench clock's zero.
        named: function from a frame, or another text given to `numbers`, to its name in the message.
    """

    def __init__(self, wall_ns: int = 0, named: Callable[[str], str] = str) -> None:
        self._wall_ns, self._named = wall_ns, named

    def with_names(self, named: Callable[[str], str]) -> MessageMaker:
        """A maker with the same clock that names frames in another way."""
        return MessageMaker(self._wall_ns, named)

    def message(self, kind: str, **fields: Any) -> Any:
        """A message of a type of ROS 2 Humble, for example `sensor_msgs/msg/Range`, with all fields by name.

        Arrays are numpy arrays of the definition's type, lists of messages are lists.
        """
        return _STORE.types[kind](**fields)

    def time(self, t_ns: int) -> Any:
        """`builtin_interfaces/Time` of a time on the bench clock, clipped to the range of 32-bit seconds."""
        return Time(*self.stamp(t_ns))

    def stamp(self, t_ns: int) -> cdr.Stamp:
        """Seconds and nanoseconds of a time on the bench clock, clipped likewise."""
        t_ns += self._wall_ns
        if not 0 <= t_ns <= _LATEST_NS:
            t_ns = min(max(0, t_ns), _LATEST_NS)
        return divmod(t_ns, NS_PER_S)

    def header(self, t_ns: int, frame: str) -> Any:
        """`std_msgs/Header` of a time on the bench clock and the frame of the values."""
        return Header(self.time(t_ns), self._named(frame))

    def vector(self, values: Sequence[float] | Array) -> Any:
        """`geometry_msgs/Vector3` of (3,)."""
        return Vector3(*_floats(values))

    def quaternion(self, q_wxyz: Sequence[float] | Array) -> Any:
        """`geometry_msgs/Quaternion` of (4,), w first."""
        w, x, y, z = _floats(q_wxyz)
        return Quaternion(x, y, z, w)

    def pose(self, position_m: Sequence[float] | Array, q_wxyz: Sequence[float] | Array) -> Any:
        """`geometry_msgs/Pose` of a position (3,) m and a quaternion (4,), w first."""
        return Pose(Point(*_floats(position_m)), self.quaternion(q_wxyz))

    def pose_stamped(
        self, t_ns: int, frame: str, position_m: Sequence[float] | Array, q_wxyz: Sequence[float] | Array
    ) -> bytes | None:
        """`geometry_msgs/PoseStamped` of a position (3,) m and a quaternion (4,), w first, as `numbers`."""
        return self.numbers(t_ns, (frame,), pose_numbers(position_m, q_wxyz))

    def numbers(self, t_ns: int, texts: tuple[str, ...], values: Sequence[float]) -> bytes | None:
        """A message of a header, texts (the header's frame, then others) and float64 values only, as CDR.

        None if a value is not finite: no other field could tell a reader so.
        """
        if not all_finite(values):
            return None
        if self._named is not str:
            texts = tuple(map(self._named, texts))
        return cdr.stamped(self.stamp(t_ns), texts, values)

    def joints(
        self,
        t_ns: int,
        names: tuple[str, ...],
        position: Array | Sequence[float] = (),
        velocity: Array | Sequence[float] = (),
        effort: Array | Sequence[float] = (),
    ) -> bytes | None:
        """`sensor_msgs/JointState` as CDR; columns are (n,), a value for each name, or (0,).

        A column without any number is empty, and a joint with a value that is not finite is left out. None
        if no joint is left.
        """
        columns = [_floats(position), _floats(velocity), _floats(effort)]
        if not all(map(all_finite, columns)):
            finite = [np.isfinite(column) for column in columns]
            given = [there for there in finite if there.any()]
            known = np.all(given, axis=0) if given else np.zeros(len(names), dtype=bool)
            if not known.any():
                return None
            names = tuple(compress(names, known))
            pairs = zip(columns, finite, strict=True)
            columns = [list(compress(column, known)) if there.any() else [] for column, there in pairs]
        return cdr.joint_state(self.stamp(t_ns), names, columns)


def all_finite(values: Sequence[float]) -> bool:
    """Whether plain numbers are all finite: a sum is, unless one is not or the sum is too large."""
    return math.isfinite(sum(values)) or all(map(math.isfinite, values))


def _floats(values: Sequence[float] | Array) -> Sequence[float]:
    """Plain Python numbers: numpy's take several times as long to write."""
    return values.tolist() if isinstance(values, np.ndarray) else values
