"""Bit-for-bit comparison of records: names the first field in which two values differ."""

import dataclasses
import math
import numbers
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Same = Callable[[Any, Any], bool]

_FLOATS = {float}


def identical(a: Any, b: Any) -> bool:
    """Whether two values are surely the same bits; quick.

    False also means "not of the same types": then only `first_difference` decides.
    """
    if a is b:
        return True
    kind = type(a)
    if kind is not type(b):
        return False
    same = _SAME.get(kind)
    if same is None:
        same = _SAME[kind] = _of_class(kind)
    return same(a, b)


def _same_arrays(a: Any, b: Any) -> bool:
    return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())


def _same_floats(a: float, b: float) -> bool:
    if a == b:
        return a != 0.0 or math.copysign(1.0, a) == math.copysign(1.0, b)
    return a != a and struct.pack("<d", a) == struct.pack("<d", b)


def _same_tuples(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return len(a) == len(b) and all(map(identical, a, b))


def _same_dicts(a: dict[Any, Any], b: dict[Any, Any]) -> bool:
    if a.keys() != b.keys():
        return False
    ours, others = tuple(a.values()), tuple(map(b.__getitem__, a))
    if set(map(type, ours)) == _FLOATS == set(map(type, others)):
        form = f"<{len(ours)}d"
        return struct.pack(form, *ours) == struct.pack(form, *others)
    return all(map(identical, ours, others))


def _same_values(a: Any, b: Any) -> bool:
    return bool(a == b)


def _of_class(kind: type) -> Same:
    """How two instances of a class are compared: dataclasses field by field, others by value."""
    if not dataclasses.is_dataclass(kind):
        return _same_values
    names = tuple(f.name for f in dataclasses.fields(kind))

    def same(a: Any, b: Any) -> bool:
        return all(identical(getattr(a, name), getattr(b, name)) for name in names)

    return same


_SAME: dict[type, Same] = {
    np.ndarray: _same_arrays,
    float: _same_floats,
    tuple: _same_tuples,
    dict: _same_dicts,
}


def first_difference(a: Any, b: Any, where: str = "") -> str | None:
    """Where two values differ first and how, or None if they are the same bits.

    Floats are compared by their 64 bits (NaN equals itself, 0.0 differs from -0.0), arrays by type,
    shape and bytes, dataclasses field by field in their order, mappings by their keys.

    Args:
        a: recorded value.
        b: value to compare with it.
        where: dotted path of the value, for the message.
    """
    if identical(a, b):
        return None
    if dataclasses.is_dataclass(a) and type(a) is type(b):
        pairs = ((f.name, getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
        return _first(pairs, where)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _array_difference(a, b, where)
    if isinstance(a, tuple) and isinstance(b, tuple):
        if len(a) != len(b):
            return f"{where}: was {len(a)} entries, now {len(b)}"
        return _first(((str(i), x, y) for i, (x, y) in enumerate(zip(a, b, strict=True))), where)
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        if set(a) != set(b):
            return f"{where}: only in one of them: {', '.join(sorted(map(str, set(a) ^ set(b))))}"
        return _first(((str(key), a[key], b[key]) for key in a), where)
    return None if _same(a, b) else f"{where}: was {a!r}, now {b!r}"


def _same(a: Any, b: Any) -> bool:
    """Numbers of one kind by value (floats by their bits), everything else by type and value."""
    if isinstance(a, (bool, np.bool_)) or isinstance(b, (bool, np.bool_)):
        return isinstance(a, (bool, np.bool_)) and isinstance(b, (bool, np.bool_)) and bool(a) == bool(b)
    if isinstance(a, numbers.Integral) and isinstance(b, numbers.Integral):
        return int(a) == int(b)
    if isinstance(a, numbers.Real) and isinstance(b, numbers.Real):
        return struct.pack("<d", a) == struct.pack("<d", b)
    return type(a) is type(b) and bool(a == b)


def _first(pairs: Any, where: str) -> str | None:
    for name, x, y in pairs:
        found = first_difference(x, y, f"{where}.{name}" if where else name)
        if found is not None:
            return found
    return None


def _array_difference(a: Any, b: Any, where: str) -> str | None:
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{where}: was {a.dtype}{a.shape}, now {b.dtype}{b.shape}"
    if a.tobytes() == b.tobytes():
        return None
    for index in np.ndindex(a.shape):
        if a[index].tobytes() != b[index].tobytes():
            return f"{where}{list(index)}: was {a[index].item()!r}, now {b[index].item()!r}"
    return None
