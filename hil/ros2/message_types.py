"""DDS types of ROS 2 messages, made from the definitions in the package rosbags.

A ROS 2 message `pkg/msg/T` is the DDS type `pkg::msg::dds_::T_`. Cyclone DDS holds every payload against its
type, in both directions, so each type is described in full. Samples themselves are CDR bytes and stay so:
they are encoded and decoded elsewhere.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from hil.core.errors import ConfigError


@cache
def type_store(distribution: str = "humble") -> Any:
    """Definitions of the messages of a distribution, by rosbags; after Iron there are no differences here."""
    return get_typestore(Stores.ROS2_HUMBLE if distribution == "humble" else Stores.ROS2_IRON)


_BASES: dict[str, Any] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "string": str,
    **{
        f"{sign}int{bits}": getattr(types, f"{sign}int{bits}")
        for sign in ("", "u")
        for bits in (8, 16, 32, 64)
    },
    "float32": types.float32,
    "float64": types.float64,
}


@cache
def sample_type(kind: str, distribution: str = "humble") -> Any:
    """Class of the samples of a message type.

    `sample_type(kind)(data)` is a sample to write; `data` holds its CDR bytes, also of one that was taken.

    Args:
        kind: name of the message type, for example `sensor_msgs/msg/Imu`.
        distribution: distribution of ROS 2 that defines it.

    Raises:
        ConfigError: ROS 2 has no such type, or one that DDS cannot carry here.
    """
    described = _described(kind, distribution)

    def serialize(self: Any, *_: object, **__: object) -> bytes:
        given: bytes = self.data
        return given

    @classmethod  # type: ignore[misc]
    def deserialize(cls: Any, data: bytes, *_: object, **__: object) -> Any:
        return cls(bytes(data))

    @classmethod  # type: ignore[misc]
    def deserialize_key(cls: Any, *_: object, **__: object) -> Any:
        """Called for the sample without data by which DDS reports that the last publisher is gone."""
        return cls(b"")

    def begin(self: Any, data: bytes) -> None:
        self.data = data

    described.__init__, described.serialize = begin, serialize
    described.deserialize, described.deserialize_key = deserialize, deserialize_key
    return described


def _described(kind: str, distribution: str) -> Any:
    """A new class with the fields of a message type."""
    defined = type_store(distribution).fielddefs
    if kind not in defined:
        raise ConfigError(
            f"message type {kind!r} cannot be published", expected=f"a type of ROS 2 {distribution.title()}"
        )
    fields = {name: _field(node, kind, distribution) for name, node in defined[kind][1]}
    package, _, name = kind.partition("/msg/")
    return make_idl_struct(name, f"{package}.msg.dds_.{name}_", fields)


@cache
def _part(kind: str, distribution: str) -> type[IdlStruct]:
    """Class of a message within another."""
    found: type[IdlStruct] = _described(kind, distribution)
    return found


def _field(node: Any, kind: str, distribution: str) -> Any:
    """DDS type of a field."""
    sort, what = node
    if sort is Nodetype.NAME:
        return _part(what, distribution)
    if sort is Nodetype.BASE:
        if what[0] == "string" and what[1]:
            return types.bounded_str[what[1]]
        if what[0] not in _BASES or what[1]:
            raise ConfigError(f"message type {kind!r} cannot be published: a field is a {what[0]}")
        return _BASES[what[0]]
    element, length = _field(what[0], kind, distribution), what[1]
    if sort is Nodetype.ARRAY:
        return types.array[element, length]
    return types.sequence[element, length] if length else types.sequence[element]
