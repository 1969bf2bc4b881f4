"""Compact, exact serialisation of `hil.vocabulary.signals.CycleRecord`.

Values are written field by field in the order of the dataclasses, floats as their 64 bits, so a
decoded record equals the encoded one bit for bit (NaN payloads included). Little endian; the layout
is that of `hil.recording.cycle_layout`, the way back is `hil.recording.cycle_decoder`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import chain, groupby
from operator import attrgetter
from typing import Any

import numpy as np

from hil.recording.cycle_layout import (
    ARRAY_HEADS,
    BYTE,
    CODES,
    COUNT,
    DTYPES,
    FLOAT,
    INT,
    MAGIC,
    Layout,
    describe,
    record_types,
)
from hil.vocabulary.kinds import DeviceKind
from hil.vocabulary.signals import CycleRecord

Put = Callable[[bytes], None]
Encode = Callable[[Put, Any], None]

DECIDED = ("measurements", "state", "reference", "setpoint", "command", "events", "observers")
"""Fields of a cycle record that the brain makes of its inputs; they follow `inputs` without a gap."""

_DOUBLE = np.dtype("<f8")
_FLAGS = (b"\x00", b"\x01")
_CHARS = {dtype: char for char, dtype in DTYPES.items()}


def _text(value: str) -> bytes:
    raw = value.encode("utf-8", "surrogatepass")
    return COUNT.pack(len(raw)) + raw


@lru_cache(maxsize=4096)
def _known_text(value: str) -> bytes:
    """Encoded form of a word that comes back every cycle (a mapping's key)."""
    return _text(value)


@lru_cache(maxsize=256)
def _double_head(shape: tuple[int, ...]) -> bytes:
    return _array_head(_DOUBLE, shape)


@lru_cache(maxsize=256)
def _array_head(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return ARRAY_HEADS[len(shape)].pack(_CHARS[dtype], len(shape), *shape)


@lru_cache(maxsize=256)
def _pairs(names: tuple[str, ...], code: str) -> tuple[struct.Struct, list[Any]]:
    """Structure of numbers by name, and its values with the names filled in."""
    raw = [_known_text(name) for name in names]
    whole = struct.Struct("<I" + "".join(f"{len(r)}s{code}" for r in raw))
    return whole, [len(raw), *chain.from_iterable((r, 0) for r in raw)]


def _code_of(layout: Layout) -> str:
    """Code of a number in `struct`; empty for anything else."""
    return CODES.get(layout, "") if isinstance(layout, str) else ""


def _numbers(layouts: list[Layout]) -> Encode:
    """Several numbers in one step."""
    pack = struct.Struct("<" + "".join(map(_code_of, layouts))).pack
    return lambda put, values: put(pack(*values))


def _kind_of(field: tuple[str, Layout]) -> str:
    """What a field can be put together with: `numbers`, `arrays`, or nothing."""
    layout = field[1]
    return "numbers" if _code_of(layout) else "arrays" if layout == "array" else ""


@lru_cache(maxsize=256)
def _row(code: str, count: int) -> struct.Struct:
    """Structure of a tuple of numbers, their count first."""
    return struct.Struct(f"<I{count}{code}")


def _encode_array(put: Put, value: Any) -> None:
    _encode_arrays(put, (value,))


def _encode_arrays(put: Put, values: Iterable[Any]) -> None:
    for value in values:
        if type(value) is np.ndarray and value.dtype is _DOUBLE:
            put(_double_head(value.shape))
            put(value.tobytes())
        else:
            _encode_other(put, value)


def _encode_other(put: Put, value: Any) -> None:
    """An array that is not of doubles, or not yet an array."""
    array = np.asarray(value)
    if array.dtype not in _CHARS:
        array = array.astype(np.int64 if array.dtype.kind in "iu" else np.float64)
    put(_array_head(array.dtype, array.shape))
    put(array.tobytes())


def _encode_any(put: Put, value: Any) -> None:
    """One value of a free mapping, tagged by its kind; a kind without a tag is kept as its text."""
    if value is None:
        put(b"n")
    elif isinstance(value, (bool, np.bool_)):
        put(b"b" + _FLAGS[bool(value)])
    elif isinstance(value, (int, np.integer)):
        put(b"i" + INT.pack(int(value)))
    elif isinstance(value, (float, np.floating)):
        put(b"f" + FLOAT.pack(float(value)))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        put(b"a")
        _encode_array(put, value)
    elif isinstance(value, (tuple, list)):
        put(b"t" + COUNT.pack(len(value)))
        for item in value:
            _encode_any(put, item)
    elif isinstance(value, Mapping):
        put(b"m" + COUNT.pack(len(value)))
        for key, item in value.items():
            put(_known_text(str(key)))
            _encode_any(put, item)
    else:
        put(b"s" + _text(str(value)))


_PRIMITIVE_ENCODERS: dict[str, Encode] = {
    "int": lambda put, value: put(INT.pack(value)),
    "float": lambda put, value: put(FLOAT.pack(value)),
    "bool": lambda put, value: put(_FLAGS[bool(value)]),
    "str": lambda put, value: put(_text(value)),
    "array": _encode_array,
    "any": _encode_any,
}


class CycleEncoder:
    """Turns cycle records into bytes.

    Args:
        added: kinds of other packages whose samples they may hold.
    """

    def __init__(self, added: tuple[DeviceKind, ...] = ()) -> None:
        self._types = record_types(added)
        self._layout = describe(added)
        self._known: dict[str, Encode] = {}
        self._root = self._class_encoder(self._layout["root"])
        self._decided = [
            (attrgetter(field), self._encoder(layout))
            for field, layout in self._layout["classes"][self._layout["root"]]
            if field in DECIDED
        ]

    def encode(self, record: CycleRecord) -> bytes:
        """Bytes of one record.

        Raises:
            struct.error, AttributeError, TypeError: the record does not follow its type hints.
        """
        parts = [MAGIC]
        self._root(parts.append, record)
        return b"".join(parts)

    def decided(self, decision: Any) -> bytes:
        """Bytes of the fields `DECIDED` of anything that has them, as they stand in a record.

        Raises:
            struct.error, AttributeError, TypeError: they do not follow their type hints.
        """
        parts: list[bytes] = []
        for get, encode_field in self._decided:
            encode_field(parts.append, get(decision))
        return b"".join(parts)

    def _encoder(self, layout: Layout) -> Encode:
        if isinstance(layout, str):
            return _PRIMITIVE_ENCODERS[layout]
        kind, inner = layout
        if kind == "class":
            return self._class_encoder(inner)
        if kind == "enum":
            codes = self._codes(inner)
            return lambda put, value: put(codes[value._value_])
        if kind == "samples":
            return self._samples(inner)
        return {"tuple": self._tuple, "optional": self._optional, "mapping": self._mapping}[kind](inner)

    def _samples(self, classes: Mapping[str, str]) -> Encode:
        encoders = {kind: self._tuple(["class", name]) for kind, name in classes.items()}

        def encode(put: Put, value: Any) -> None:
            put(COUNT.pack(len(value)))
            for kind, samples in value.items():
                put(_known_text(kind))
                encoders[kind](put, samples)

        return encode

    def _class_encoder(self, name: str) -> Encode:
        """Neighbouring numbers, those of inner classes too, go in one step, and so do neighbouring arrays."""
        if name in self._known:
            return self._known[name]
        steps: list[tuple[Callable[[Any], Any], Encode]] = []
        for kind, run in groupby(self._flat(name), _kind_of):
            fields = list(run)
            if not kind or len(fields) == 1:
                steps += [(attrgetter(path), self._encoder(layout)) for path, layout in fields]
                continue
            together = _encode_arrays if kind == "arrays" else _numbers([layout for _, layout in fields])
            steps.append((attrgetter(*(path for path, _ in fields)), together))

        def encode(put: Put, value: Any) -> None:
            for get, encode_part in steps:
                encode_part(put, get(value))

        self._known[name] = encode
        return encode

    def _flat(self, name: str, before: str = "") -> Iterator[tuple[str, Layout]]:
        """Fields of a class with their layouts; those of classes inside it by dotted names."""
        for field, layout in self._layout["classes"][name]:
            if not isinstance(layout, str) and layout[0] == "class":
                yield from self._flat(layout[1], f"{before}{field}.")
            else:
                yield before + field, layout

    def _codes(self, name: str) -> dict[Any, bytes]:
        """Bytes of an enumeration's members by their values."""
        return {member._value_: BYTE.pack(i) for i, member in enumerate(self._types[name])}

    def _tuple(self, layout: Layout) -> Encode:
        code = _code_of(layout)
        if code:
            return lambda put, value: put(_row(code, len(value)).pack(len(value), *value))
        if layout[0] == "enum":
            return self._members(layout[1])
        encode_item = self._encoder(layout)

        def encode(put: Put, value: Any) -> None:
            put(COUNT.pack(len(value)))
            for item in value:
                encode_item(put, item)

        return encode

    def _members(self, name: str) -> Encode:
        """A tuple of an enumeration's members; most are as the one before (all channels are well)."""
        codes = self._codes(name)
        last: tuple[Any, ...] = ()
        encoded = COUNT.pack(0)

        def encode(put: Put, value: Any) -> None:
            nonlocal last, encoded
            if value != last:
                encoded = COUNT.pack(len(value)) + b"".join([codes[item._value_] for item in value])
                last = value
            put(encoded)

        return encode

    def _optional(self, layout: Layout) -> Encode:
        if code := _code_of(layout):
            pack = struct.Struct(f"<?{code}").pack
            return lambda put, value: put(b"\x00" if value is None else pack(True, value))
        encode_value = self._encoder(layout)

        def encode(put: Put, value: Any) -> None:
            if value is None:
                put(b"\x00")
            else:
                put(b"\x01")
                encode_value(put, value)

        return encode

    def _mapping(self, layout: Layout) -> Encode:
        encode_value = self._encoder(layout)
        code = CODES.get(layout) if isinstance(layout, str) else None

        def encode(put: Put, value: Any) -> None:
            if code is not None:
                whole, filled = _pairs(tuple(value), code)
                values = filled.copy()
                values[2::2] = value.values()
                put(whole.pack(*values))
                return
            put(COUNT.pack(len(value)))
            for key, item in value.items():
                put(_known_text(key))
                encode_value(put, item)

        return encode
