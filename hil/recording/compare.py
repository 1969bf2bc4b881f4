"""Bit-for-bit comparison of records: names the first field in which two values differ."""

from __future__ import annotations

import dataclasses
import numbers
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np


def first_difference(a: Any, b: Any, where: str = "") -> str | None:
    """Where two values differ first and how, or None if they are the same bits.

    Floats are compared by their 64 bits (NaN equals itself, 0.0 differs from -0.0), arrays by type,
    shape and bytes, dataclasses field by field in their order, mappings by their keys.

    Args:
        a: recorded value.
        b: value to hold against it.
        where: dotted path of the value, for the message.
    """
    if dataclasses.is_dataclass(a) and type(a) is type(b):
        pairs = ((f.name, getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
        return _first(pairs, where)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _array_difference(a, b, where)
    if isinstance(a, tuple) and isinstance(b, tuple):
        if len(a) != len(b):
            return f"{where}: {len(a)} entries and {len(b)}"
        return _first(((str(i), x, y) for i, (x, y) in enumerate(zip(a, b, strict=True))), where)
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        if set(a) != set(b):
            return f"{where}: only in one of them: {', '.join(sorted(map(str, set(a) ^ set(b))))}"
        return _first(((str(key), a[key], b[key]) for key in a), where)
    return None if _same(a, b) else f"{where}: {a!r} and {b!r}"


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
        return f"{where}: {a.dtype}{a.shape} and {b.dtype}{b.shape}"
    if a.tobytes() == b.tobytes():
        return None
    for index in np.ndindex(a.shape):
        if a[index].tobytes() != b[index].tobytes():
            return f"{where}{list(index)}: {a[index]!r} and {b[index]!r}"
    return None
