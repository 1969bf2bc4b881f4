"""Checks values of drivers of other packages by the type hints of their fields."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hil.core.device import DeviceKind
from hil.core.geometry import Array
from hil.core.signals import Stamp, Status
from hil.recording.cycle_codec import DTYPES

_LEAST, _MOST = -(2**63), 2**63 - 1
_PLAIN: Mapping[Any, tuple[type[Any], ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    str: (str,),
}

_SERVOS, _WHEELS, _VECTOR, _QUATERNION = (8,), (4,), (3,), (4,)
_SHAPES: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "ServoSample": dict.fromkeys(("position_rad", "velocity_rad_s", "current_a"), _SERVOS),
    "EncoderSample": {"angle_rad": _WHEELS},
    "ImuSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("gyro_rad_s", "linear_acceleration_m_s2", "gravity_m_s2"), _VECTOR),
    "TrackerSample": {"quaternion_wxyz": _QUATERNION}
    | dict.fromkeys(("position_m", "velocity_m_s", "angular_velocity_rad_s"), _VECTOR),
    "MocapSample": {"position_m": _VECTOR, "quaternion_wxyz": _QUATERNION},
    "LoadCellSample": {"force_n": (2,)},
}
"""Shapes of the arrays that `hil.core.signals` promises, by sample and field."""

Wrong = Callable[[Any], str]


def short(value: Any) -> str:
    """A value as a message shows it: its first 60 characters."""
    try:
        text = repr(value)
    except Exception:  # of a class of the package, or of a number of thousands of digits
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."


def checks_of(kind: DeviceKind) -> list[tuple[str, str, Wrong]]:
    """(name, expected, check of a value) for each field of a kind's sample."""
    shapes = _SHAPES.get(kind.sample.__name__, {})
    found: list[tuple[str, str, Wrong]] = []
    for field, hint in typing.get_type_hints(kind.sample).items():
        if field == "stamp":
            found.append((field, "a Stamp of whole ns: Stamp(t_ns: int, host_ns: int, seq: int)", _of_stamp))
        elif field == "status" and (kind.labels or hint is not Status):
            many = f"{len(kind.labels)} Status: " if kind.labels else "Status"
            message = f"a tuple of {many}{', '.join(kind.labels)}, one for each channel"
            found.append((field, message, functools.partial(_of_status, len(kind.labels))))
        elif hint == Array:
            shape = shapes.get(field)
            shape_text = f" of shape {shape}" if shape else ""
            expected = f"a numpy array of float64, float32, int64 or bool{shape_text}"
            found.append((field, expected, functools.partial(_of_array, shape)))
        else:
            found.append((field, f"a {_written(hint)}", _of(hint)))
    return found


def _written(hint: Any) -> str:
    """A type hint as its author wrote it."""
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)


def _of(hint: Any) -> Wrong:
    """What is wrong with a value of this type hint, of those that can be recorded."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return lambda value: ""
    if hint == Array:
        return functools.partial(_of_array, None)
    if hint in _PLAIN:
        return functools.partial(_of_plain, _PLAIN[hint])
    if origin is tuple:
        count = None if args[1:] == (...,) else len(args)
        return functools.partial(_of_tuple, count, _of(args[0]))
    if origin is Mapping or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return functools.partial(_of_mapping, _of(args[1]))
    if type(None) in args:
        inner = _of(next(a for a in args if a is not type(None)))
        return lambda value: "" if value is None else inner(value)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        inside = {name: _of(of) for name, of in typing.get_type_hints(hint).items()}
        return functools.partial(_of_class, hint, inside)
    return functools.partial(_of_plain, (hint,))


def _of_stamp(value: Any) -> str:
    if not isinstance(value, Stamp):
        return short(value)
    for name in ("t_ns", "host_ns", "seq", "device_ns"):
        number = getattr(value, name)
        if (type(number) is not int or not _LEAST <= number <= _MOST) and (
            number is not None or name != "device_ns"
        ):
            return f"with {name} {short(number)}"
    return ""


def _of_status(count: int, value: Any) -> str:
    if not isinstance(value, tuple) or not all(isinstance(state, Status) for state in value):
        return short(value)
    return f"of length {len(value)}" if count and len(value) != count else ""


def _of_array(shape: tuple[int, ...] | None, value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return short(value)
    if value.dtype not in DTYPES:
        return f"of {value.dtype}"
    return "" if shape is None or value.shape == shape else f"of shape {value.shape}"


def _of_plain(types: tuple[type[Any], ...], value: Any) -> str:
    if not isinstance(value, types):
        return short(value)
    if types is _PLAIN[int] and not _LEAST <= value <= _MOST:
        return f"{short(value)}, which 64 bits do not hold"
    if types is _PLAIN[float] and not isinstance(value, float):
        try:
            float(value)
        except OverflowError:
            return f"{short(value)}, which no float holds"
    return ""


def _of_tuple(count: int | None, wrong: Wrong, value: Any) -> str:
    good = isinstance(value, tuple) and count in (None, len(value)) and not any(map(wrong, value))
    return "" if good else short(value)


def _of_mapping(wrong: Wrong, value: Any) -> str:
    good = isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    return "" if good and not any(map(wrong, value.values())) else short(value)


def _of_class(kind: type[Any], inside: Mapping[str, Wrong], value: Any) -> str:
    good = isinstance(value, kind) and not any(wrong(getattr(value, name)) for name, wrong in inside.items())
    return "" if good else short(value)
