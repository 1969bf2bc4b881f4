"""Back from bytes to `hil.signals.CycleRecord`, by the layout that the recording itself carries.

A field that the file lacks gets its default; a field or status that this version does not know is
skipped and named in `notes`. Bytes that do not follow their layout raise `ValueError`.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hil.recording.cycle_layout import (
    ARRAY_HEADS,
    COUNT,
    DTYPES,
    FLOAT,
    FORMAT,
    INT,
    MAGIC,
    Layout,
    record_types,
)
from hil.signals import CycleRecord, Status

_KNOWN_KEYS = 4096

Decode = Callable[[bytes, int], "tuple[Any, int]"]


def _decode_int(data: bytes, at: int) -> tuple[int, int]:
    return INT.unpack_from(data, at)[0], at + 8


def _decode_float(data: bytes, at: int) -> tuple[float, int]:
    return FLOAT.unpack_from(data, at)[0], at + 8


def _decode_bool(data: bytes, at: int) -> tuple[bool, int]:
    return data[at] != 0, at + 1


def _decode_text(data: bytes, at: int) -> tuple[str, int]:
    end = at + 4 + COUNT.unpack_from(data, at)[0]
    if end > len(data):
        raise ValueError("a text runs beyond the end of the record")
    return data[at + 4 : end].decode("utf-8", "surrogatepass"), end


def _decode_array(data: bytes, at: int) -> tuple[Any, int]:
    dtype, ndim = DTYPES[data[at : at + 1]], data[at + 1]
    shape_of = ARRAY_HEADS[ndim]
    shape = shape_of.unpack_from(data, at)[2:]
    at += shape_of.size
    count = shape[0] if ndim == 1 else math.prod(shape)
    array = np.frombuffer(data, dtype, count, at) if count else np.empty(0, dtype)
    end = at + count * dtype.itemsize
    return (array.copy() if ndim == 1 else array.reshape(shape).copy()), end


def _decode_any(data: bytes, at: int) -> tuple[Any, int]:
    tag, at = data[at : at + 1], at + 1
    if tag == b"n":
        return None, at
    plain = {
        b"b": _decode_bool,
        b"i": _decode_int,
        b"f": _decode_float,
        b"s": _decode_text,
        b"a": _decode_array,
    }
    if tag in plain:
        return plain[tag](data, at)
    if tag not in (b"t", b"m"):
        raise ValueError(f"unknown tag {tag!r}")
    (count,), at = COUNT.unpack_from(data, at), at + 4
    if tag == b"t":
        items = []
        for _ in range(count):
            item, at = _decode_any(data, at)
            items.append(item)
        return tuple(items), at
    mapping = {}
    for _ in range(count):
        key, at = _decode_text(data, at)
        mapping[key], at = _decode_any(data, at)
    return mapping, at


_PRIMITIVE_DECODERS: dict[str, Decode] = {
    "int": _decode_int,
    "float": _decode_float,
    "bool": _decode_bool,
    "str": _decode_text,
    "array": _decode_array,
    "any": _decode_any,
}


def _packed(layouts: list[Layout]) -> struct.Struct | None:
    """One structure for a class of plain numbers; None for any other."""
    codes = {"int": INT, "float": FLOAT}
    found = [codes.get(layout) if isinstance(layout, str) else None for layout in layouts]
    if None in found:
        return None
    return struct.Struct("<" + "".join(f.format.lstrip("<") for f in found if f is not None))


class CycleDecoder:
    """Turns bytes back into cycle records.

    Args:
        description: what `describe` gave when the recording was written.

    Raises:
        ValueError: the description is of a newer format, malformed, or lacks what a record needs.
    """

    def __init__(self, description: Mapping[str, Any]) -> None:
        self._notes: list[str] = []
        try:
            found, root = description["format"], description["root"]
            if found != FORMAT:
                raise ValueError(f"cycle format {found} is not format {FORMAT}")
            self._layouts, self._enums = description["classes"], description["enums"]
            self._classes: dict[str, Decode] = {}
            for name in self._layouts:
                self._classes[name] = self._class_decoder(name)
            self._root = self._classes[root]
        except (KeyError, TypeError) as error:
            raise ValueError(f"the layout of the cycle records is malformed ({error!r})") from None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the file has and this version does not know."""
        return tuple(self._notes)

    def decode(self, data: bytes) -> CycleRecord:
        """One record.

        Raises:
            ValueError: the bytes do not follow the layout.
        """
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("not a cycle record (wrong first bytes)")
        try:
            record, end = self._root(data, len(MAGIC))
        except (struct.error, IndexError, KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"malformed cycle record ({error})") from None
        if end != len(data) or not isinstance(record, CycleRecord):
            raise ValueError(f"cycle record of {len(data)} bytes ends at {end}")
        return record

    def _decoder(self, layout: Layout) -> Decode:
        if isinstance(layout, str):
            return _PRIMITIVE_DECODERS[layout]
        kind, inner = layout
        if kind == "class":
            classes = self._classes
            return lambda data, at: classes[inner](data, at)
        if kind == "enum":
            return self._enum(inner)
        return {"tuple": self._tuple, "optional": self._optional, "mapping": self._mapping}[kind](inner)

    def _class_decoder(self, name: str) -> Decode:
        kind = record_types().get(name, dict)
        decoders = [self._decoder(layout) for _, layout in self._layouts[name]]
        names = [field for field, _ in self._layouts[name]]
        known = [f.name for f in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else names
        unknown = [field for field in names if field not in known]
        self._notes += [f"field {name}.{field} is of another version and was skipped" for field in unknown]
        if dataclasses.is_dataclass(kind):
            for field in dataclasses.fields(kind):
                optional = (field.default, field.default_factory) != (dataclasses.MISSING,) * 2
                if field.name not in names and not optional:
                    raise ValueError(f"the recording lacks {name}.{field.name}")

        def decode_same(data: bytes, at: int) -> tuple[Any, int]:
            values = []
            for decode in decoders:
                value, at = decode(data, at)
                values.append(value)
            return kind(*values), at

        def decode_named(data: bytes, at: int) -> tuple[Any, int]:
            values = {}
            for field, decode in zip(names, decoders, strict=True):
                values[field], at = decode(data, at)
            return kind(**{field: value for field, value in values.items() if field not in unknown}), at

        if names != known or kind is dict:
            return decode_named
        packed = _packed([layout for _, layout in self._layouts[name]])
        if packed is None:
            return decode_same

        def decode_packed(data: bytes, at: int) -> tuple[Any, int]:
            return kind(*packed.unpack_from(data, at)), at + packed.size

        return decode_packed

    def _enum(self, name: str) -> Decode:
        kind = record_types().get(name)
        table: list[Any] = list(self._enums[name])
        if kind is not None and issubclass(kind, enum.Enum):
            known = {member.value: member for member in kind}
            for value in table:
                if value not in known:
                    self._notes.append(
                        f"{name} {value!r} is of another version, read as {Status.PROTOCOL.value!r}"
                    )
            table = [known.get(value, Status.PROTOCOL) for value in table]
        return lambda data, at: (table[data[at]], at + 1)

    def _tuple(self, layout: Layout) -> Decode:
        decode_item = self._decoder(layout)

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            (count,), at = COUNT.unpack_from(data, at), at + 4
            items = []
            for _ in range(count):
                item, at = decode_item(data, at)
                items.append(item)
            return tuple(items), at

        return decode

    def _optional(self, layout: Layout) -> Decode:
        decode_value = self._decoder(layout)

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            return decode_value(data, at + 1) if data[at] else (None, at + 1)

        return decode

    def _mapping(self, layout: Layout) -> Decode:
        decode_value = self._decoder(layout)
        floats = layout == "float"
        keys: dict[bytes, str] = {}  # the same words come back every cycle

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            (count,), at = COUNT.unpack_from(data, at), at + 4
            mapping = {}
            for _ in range(count):
                end = at + 4 + COUNT.unpack_from(data, at)[0]
                raw = data[at:end]
                key = keys.get(raw)
                if key is None:
                    key, _ = _decode_text(data, at)
                    if len(keys) < _KNOWN_KEYS:
                        keys[raw] = key
                if floats:
                    mapping[key], at = FLOAT.unpack_from(data, end)[0], end + 8
                else:
                    mapping[key], at = decode_value(data, end)
            return mapping, at

        return decode
