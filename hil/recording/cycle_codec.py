"""Compact, exact serialisation of `hil.vocabulary.signals.CycleRecord`.

Values are written field by field in the order of the dataclasses, floats as their 64 bits, so a
decoded record equals the encoded one bit for bit (NaN payloads included). Little endian; the layout
is that of `hil.recording.cycle_layout`, the way back is `hil.recording.cycle_decoder`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import chain
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
def _array_head(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return ARRAY_HEADS[len(shape)].pack(_CHARS[dtype], len(shape), *shape)


@lru_cache(maxsize=256)
def _pairs(names: tuple[str, ...], code: str) -> tuple[struct.Struct, list[Any]]:
    """Structure of numbers by name, and its values with the names filled in."""
    raw = [_known_text(name) for name in names]
    whole = struct.Struct("<I" + "".join(f"{len(r)}s{code}" for r in raw))
    return whole, [len(raw), *chain.from_iterable((r, 0) for r in raw)]


def _encode_array(put: Put, value: Any) -> None:
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
        self._classes: dict[str, list[tuple[str, Encode]]] = {name: [] for name in self._layout["classes"]}
        for name, fields in self._layout["classes"].items():
            self._classes[name] += [(field, self._encoder(layout)) for field, layout in fields]
        self._root = self._class_encoder(self._layout["root"])

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
        for field, encode_field in self._classes[self._layout["root"]]:
            if field in DECIDED:
                encode_field(parts.append, getattr(decision, field))
        return b"".join(parts)

    def _encoder(self, layout: Layout) -> Encode:
        if isinstance(layout, str):
            return _PRIMITIVE_ENCODERS[layout]
        kind, inner = layout
        if kind == "class":
            return self._class_encoder(inner)
        if kind == "enum":
            members: list[Any] = list(self._types[inner])
            codes = {member: BYTE.pack(i) for i, member in enumerate(members)}
            return lambda put, value: put(codes[value])
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
        fields = self._classes[name]

        def encode(put: Put, value: Any) -> None:
            for field, encode_field in fields:
                encode_field(put, getattr(value, field))

        return encode

    def _tuple(self, layout: Layout) -> Encode:
        encode_item = self._encoder(layout)

        def encode(put: Put, value: Any) -> None:
            put(COUNT.pack(len(value)))
            for item in value:
                encode_item(put, item)

        return encode

    def _optional(self, layout: Layout) -> Encode:
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
