"""Compact, exact serialisation of `hil.signals.CycleRecord`.

Values are written field by field in the order of the dataclasses, floats as their 64 bits, so a
decoded record equals the encoded one bit for bit (NaN payloads included). Little endian; the layout
is that of `hil.recording.cycle_layout`, the way back is `hil.recording.cycle_decoder`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hil.recording.cycle_layout import (
    ARRAY_HEADS,
    BYTE,
    COUNT,
    DTYPES,
    FLOAT,
    INT,
    MAGIC,
    Layout,
    describe,
    record_types,
)
from hil.signals import CycleRecord

Put = Callable[[bytes], None]
Encode = Callable[[Put, Any], None]

_FLAGS = (b"\x00", b"\x01")
_CHARS = {dtype: char for char, dtype in DTYPES.items()}


def _text(value: str) -> bytes:
    raw = value.encode("utf-8", "surrogatepass")
    return COUNT.pack(len(raw)) + raw


@lru_cache(maxsize=4096)
def _known_text(value: str) -> bytes:
    """Encoded form of a word that comes back every cycle (a mapping's key)."""
    return _text(value)


def _encode_array(put: Put, value: Any) -> None:
    array = np.asarray(value)
    char = _CHARS.get(array.dtype)
    if char is None:
        array = array.astype(np.int64 if array.dtype.kind in "iu" else np.float64)
        char = _CHARS[array.dtype]
    put(ARRAY_HEADS[array.ndim].pack(char, array.ndim, *array.shape))
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
    """Turns cycle records into bytes."""

    def __init__(self) -> None:
        self._layout = describe()
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

    def _encoder(self, layout: Layout) -> Encode:
        if isinstance(layout, str):
            return _PRIMITIVE_ENCODERS[layout]
        kind, inner = layout
        if kind == "class":
            return self._class_encoder(inner)
        if kind == "enum":
            members: list[Any] = list(record_types()[inner])
            codes = {member: BYTE.pack(i) for i, member in enumerate(members)}
            return lambda put, value: put(codes[value])
        return {"tuple": self._tuple, "optional": self._optional, "mapping": self._mapping}[kind](inner)

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

        def encode(put: Put, value: Any) -> None:
            put(COUNT.pack(len(value)))
            for key, item in value.items():
                put(_known_text(key))
                encode_value(put, item)

        return encode
