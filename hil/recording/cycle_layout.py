"""The layout of a cycle record, derived from the type hints of `hil.vocabulary.signals`.

It travels with every recording, so that a reader of another version can still take what it knows.
A layout is JSON: a primitive name (`int float bool str array any`), or a pair such as
`["tuple", layout]`, `["optional", layout]`, `["mapping", layout]`, `["enum", name]`, `["class", name]`, and
`["samples", {kind: class name}]` for the samples of kinds of devices that other packages add.
"""

from __future__ import annotations

import dataclasses
import enum
import struct
import typing
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from hil.vocabulary.device import DeviceKind
from hil.vocabulary.errors import ConfigError
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import kinds
from hil.vocabulary.signals import CycleRecord, Inputs

FORMAT = 1
MAGIC = b"HIL\x01"

Layout = Any

INT, FLOAT, COUNT, BYTE = struct.Struct("<q"), struct.Struct("<d"), struct.Struct("<I"), struct.Struct("<B")
MAX_DIMENSIONS = 4
ARRAY_HEADS = tuple(struct.Struct(f"<cB{n}I") for n in range(MAX_DIMENSIONS + 1))
CODES = {"int": "q", "float": "d", "bool": "?"}
DTYPES: dict[bytes, np.dtype[Any]] = {
    b"d": np.dtype("<f8"),
    b"f": np.dtype("<f4"),
    b"q": np.dtype("<i8"),
    b"?": np.dtype("?"),
}
_SERVOS, _WHEELS, _VECTOR, _QUATERNION = (8,), (4,), (3,), (4,)
SHAPES: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "ServoSample": dict.fromkeys(("position_rad", "velocity_rad_s", "current_a"), _SERVOS),
    "ServoHealth": dict.fromkeys(("voltage_v", "temperature_c"), _SERVOS),
    "EncoderSample": {"angle_rad": _WHEELS},
    "ImuSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("gyro_rad_s", "linear_acceleration_m_s2", "gravity_m_s2"), _VECTOR),
    "TrackerSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("position_m", "velocity_m_s", "angular_velocity_rad_s"), _VECTOR),
    "MocapSample": {"position_m": _VECTOR, "quaternion_wxyz": _QUATERNION},
    "LoadCellSample": {"force_n": (2,)},
    "WheelMeasurement": dict.fromkeys(("wheel_angle_rad", "wheel_rate_rad_s", "steering_rad"), _WHEELS),
    "GyroMeasurement": {"acceleration_m_s2": (2,)},
    "PoseMeasurement": {"pose": _VECTOR},
    "RobotState": {"pose_body_in_wall": _VECTOR, "twist_body": _VECTOR, "covariance": (6, 6)},
    "Reference": dict.fromkeys(("pose_in_wall", "twist_body", "acceleration_wall"), _VECTOR),
    "WheelSetpoint": dict.fromkeys(("wheel_rate_rad_s", "steering_rad"), _WHEELS),
    "ServoSetpoint": dict.fromkeys(("drive_velocity_rad_s", "steer_position_rad"), _WHEELS),
}
"""Shapes of the arrays that `hil.vocabulary.signals` promises, by class and field."""


def layout_of(hint: Any) -> Layout:
    """Layout of one type hint used in `hil.vocabulary.signals`.

    Raises:
        TypeError: a hint that the codec has no rule for (found by the tests, not by a user).
    """
    simple = {int: "int", float: "float", bool: "bool", str: "str", Any: "any"}
    if hint in simple:
        return simple[hint]
    if hint == Array:
        return "array"
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        return ["tuple", layout_of(args[0])]
    if origin is Mapping:
        return ["mapping", layout_of(args[1])]
    if type(None) in args:
        return ["optional", layout_of(next(a for a in args if a is not type(None)))]
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return ["enum", hint.__name__]
    if dataclasses.is_dataclass(hint):
        return ["class", hint.__name__]  # type: ignore[union-attr]
    raise TypeError(f"no layout for {hint!r}")


def _collect(hint: Any, found: dict[str, Any]) -> None:
    """Collect the dataclasses and enumerations that a hint reaches."""
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or issubclass(hint, enum.Enum)):
        if hint.__name__ not in found:
            found[hint.__name__] = hint
            if dataclasses.is_dataclass(hint):
                for inner in typing.get_type_hints(hint).values():
                    _collect(inner, found)
        return
    for inner in typing.get_args(hint):
        _collect(inner, found)


@cache
def record_types(added: tuple[DeviceKind, ...] = ()) -> dict[str, Any]:
    """Dataclasses and enumerations that make up a cycle record, by name.

    Args:
        added: kinds of other packages whose samples it may hold.

    Raises:
        ConfigError: a kind's sample has the name of another class, or holds what cannot be recorded.
    """
    found: dict[str, Any] = {}
    _collect(CycleRecord, found)
    for kind in added:
        name = kind.sample.__name__
        if found.get(name, kind.sample) is not kind.sample:
            raise ConfigError(
                f"samples of the kind {kind.name} ({kind.package}) are called {name}, as others are",
                remedy="give the class another name",
            )
        _collect(kind.sample, found)
        try:
            for hint in typing.get_type_hints(kind.sample).values():
                layout_of(hint)
        except (TypeError, NameError) as error:
            raise ConfigError(
                f"samples of the kind {kind.name} ({kind.package}) cannot be recorded ({error})",
                expected="fields of type int, float, bool, str, Array, Status, Stamp, a dataclass of them, "
                "X | None, tuple[X, ...] or Mapping[str, X]",
            ) from None
    return found


@cache
def describe(added: tuple[DeviceKind, ...] = ()) -> Mapping[str, Any]:
    """Layout of a cycle record as JSON, stored in every recording; the same object for the same kinds.

    Args:
        added: kinds of other packages whose samples it may hold; they are named with their packages.
    """
    classes: dict[str, Any] = {}
    enums = {}
    for name, kind in record_types(added).items():
        if issubclass(kind, enum.Enum):
            enums[name] = [member.value for member in kind]
        else:
            hints = typing.get_type_hints(kind)
            classes[name] = [[f.name, layout_of(hints[f.name])] for f in dataclasses.fields(kind)]
    samples = ["samples", {kind.name: kind.sample.__name__ for kind in added}]
    classes[Inputs.__name__] = [
        [name, samples if name == "added" else layout] for name, layout in classes[Inputs.__name__]
    ]
    packages = {"packages": {kind.name: kind.package for kind in added}} if added else {}
    return {"format": FORMAT, "root": CycleRecord.__name__, "classes": classes, "enums": enums, **packages}


def added_in(description: Mapping[str, Any]) -> tuple[DeviceKind, ...]:
    """The kinds of other packages whose samples a recording may hold.

    Raises:
        ConfigError: a package that it needs is not installed; it names all that are missing.
    """
    named: Mapping[str, str] = dict(description.get("packages", {}))
    check_packages(named)
    return tuple(kinds()[name] for name in named)


def check_packages(named: Mapping[str, Any]) -> None:
    """Refuse a recording of devices that nothing here knows.

    Args:
        named: name and version of the package by what it adds, `KIND` or `KIND.MODEL`.

    Raises:
        ConfigError: it names all that are missing.
    """
    missing = {name: str(package) for name, package in named.items() if not _is_known(name)}
    if missing:
        told = ", ".join(f"{name} ({package})" for name, package in missing.items())
        packages = dict.fromkeys(package for package in missing.values() if package.split())
        raise ConfigError(
            f"the recording holds samples of devices that nothing here knows: {told}",
            expected="the package that adds each",
            remedy=f"install {', '.join(packages)} from where you got it",
        )


def _is_known(name: str) -> bool:
    kind_name, _, model = name.partition(".")
    kind = kinds().get(kind_name)
    return kind is not None and (not model or any(m.name == model for m in kind.models))
