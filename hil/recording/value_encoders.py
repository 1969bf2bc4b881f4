"""How single values of a cycle record are written: texts, arrays, tuples, mappings and free values.

The counterpart of `hil.recording.value_decoders`; the source that `hil.recording.encoder_source` writes calls
these by the names in `BY_NAME`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from itertools import chain
from typing import Any

import numpy as np

from hil.recording.cycle_layout import ARRAY_HEADS, COUNT, DTYPES

Parts = list[bytes]
FEW = 64
"""How many counts, from 0, are kept as bytes."""

_DOUBLE = np.dtype("<f8")
_CHARS = {dtype: char for char, dtype in DTYPES.items()}


class _Made(dict[Any, Any]):
    """What is made of a key when it is first asked for; for keys of which there are few."""

    def __init__(self, make: Callable[[Any], Any]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, key: Any) -> Any:
        made = self[key] = self._make(key)
        return made


def _text(value: str) -> bytes:
    raw = value.encode("utf-8", "surrogatepass")
    return COUNT.pack(len(raw)) + raw


text = lru_cache(maxsize=4096)(_text)
"""A text: the same names and words come back every cycle."""


def array_head(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """What precedes the values of an array."""
    return ARRAY_HEADS[len(shape)].pack(_CHARS[dtype], len(shape), *shape)


def array(value: Any) -> tuple[bytes, bytes]:
    """Head and values of an array of any type, or of what can be made one."""
    given = np.asarray(value)
    if given.dtype not in _CHARS:
        given = given.astype(np.int64 if given.dtype.kind in "iu" else np.float64)
    return array_head(given.dtype, given.shape), given.tobytes()


@lru_cache(maxsize=256)
def row(code: str, count: int) -> Callable[..., bytes]:
    """What packs a tuple of numbers, their count first."""
    return struct.Struct(f"<I{count}{code}").pack


def whole_row_of(code: str) -> Callable[[tuple[int, ...]], bytes]:
    """What writes a tuple of whole numbers or truth values; most are as the one before."""
    last: tuple[int, ...] = ()
    encoded = COUNT.pack(0)

    def encode(value: tuple[int, ...]) -> bytes:
        nonlocal last, encoded
        if value != last:
            encoded = row(code, len(value))(len(value), *value)
            last = value
        return encoded

    return encode


def pairs_of(code: str) -> Callable[[Mapping[str, float]], bytes]:
    """What writes numbers by name; most have the names of those before."""
    last: tuple[str, ...] = ()
    pack = COUNT.pack
    filled: list[Any] = [0]

    def encode(value: Mapping[str, float]) -> bytes:
        nonlocal last, pack, filled
        names = tuple(value)
        if names != last:
            raw = [text(name) for name in names]
            pack = struct.Struct("<I" + "".join(f"{len(r)}s{code}" for r in raw)).pack
            filled = [len(raw), *chain.from_iterable((r, 0) for r in raw)]
            last = names
        values = filled.copy()
        values[2::2] = value.values()
        return pack(*values)

    return encode


def members_of(codes: Mapping[Any, bytes]) -> Callable[[tuple[Any, ...]], bytes]:
    """What writes a tuple of an enumeration's members; most are as the one before (all channels are well).

    Args:
        codes: bytes of the members by their values.
    """
    last: tuple[Any, ...] = ()
    encoded = COUNT.pack(0)

    def encode(value: tuple[Any, ...]) -> bytes:
        nonlocal last, encoded
        if value != last:
            encoded = COUNT.pack(len(value)) + b"".join([codes[item._value_] for item in value])
            last = value
        return encoded

    return encode


_TAGGED: Mapping[type, Callable[[Any], bytes]] = {
    bool: partial(struct.Struct("<c?").pack, b"b"),
    int: partial(struct.Struct("<cq").pack, b"i"),
    float: partial(struct.Struct("<cd").pack, b"f"),
}
"""What writes a number or truth value with its tag."""


def free(value: Any, parts: Parts) -> None:
    """One value of a free mapping, tagged by its kind; a kind without a tag is kept as its text."""
    kind = type(value)
    if kind is np.ndarray and value.dtype is _DOUBLE:
        parts += (b"a", _HEADS[value.shape], value.tobytes())
    elif kind in _TAGGED:
        parts.append(_TAGGED[kind](value))
    elif value is None:
        parts.append(b"n")
    elif isinstance(value, np.bool_):
        parts.append(_TAGGED[bool](value))
    elif isinstance(value, (int, np.integer)):
        parts.append(_TAGGED[int](int(value)))
    elif isinstance(value, (float, np.floating)):
        parts.append(_TAGGED[float](float(value)))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        parts += (b"a", *array(value))
    elif isinstance(value, (tuple, list)):
        parts.append(b"t" + COUNT.pack(len(value)))
        for item in value:
            free(item, parts)
    elif isinstance(value, Mapping):
        parts.append(b"m" + COUNT.pack(len(value)))
        for key, item in value.items():
            parts.append(text(str(key)))
            free(item, parts)
    else:
        parts.append(b"s" + _text(str(value)))


_HEADS = _Made(lambda shape: array_head(_DOUBLE, shape))
BY_NAME: Mapping[str, Any] = {
    "ndarray": np.ndarray,
    "double": _DOUBLE,
    "heads": _HEADS,
    "counts": [COUNT.pack(number) for number in range(FEW)],
    **{f.__name__: f for f in (array, row, whole_row_of, pairs_of, members_of, free)},
    "text": text,
}
"""What the generated source calls."""
