"""Compact, exact serialisation of `hil.signals.CycleRecord`.

Values are written field by field in the order of the dataclasses, floats as their 64 bits, so a
decoded record equals the encoded one bit for bit (NaN payloads included). The layout is derived from
the type hints and travels with the file (`describe`), so a reader of another version can still take
what it knows: missing fields get their defaults, unknown ones are skipped and named.

Little endian. A layout is JSON: a primitive name (`int float bool str array any`), or a pair such as
`["tuple", layout]`, `["optional", layout]`, `["mapping", layout]`, `["enum", name]`, `["class", name]`.
"""

from __future__ import annotations

import dataclasses
import enum
import struct
import typing
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from hil.errors import DataError
from hil.signals import CycleRecord

FORMAT = 1
MAGIC = b"HIL\x01"

Layout = Any
Encode = Callable[[Callable[[bytes], None], Any], None]
Decode = Callable[[bytes, int], "tuple[Any, int]"]

_INT, _FLOAT, _COUNT, _BYTE = struct.Struct("<q"), struct.Struct("<d"), struct.Struct("<I"), struct.Struct("<B")
_FLAGS = (b"\x00", b"\x01")
_SHAPES = {n: struct.Struct(f"<cB{n}I") for n in range(5)}
_DTYPES = {b"d": np.dtype("<f8"), b"f": np.dtype("<f4"), b"q": np.dtype("<i8"), b"?": np.dtype("?")}
_CHARS = {dtype: char for char, dtype in _DTYPES.items()}
_ANY_TYPES = (bool, int, float, str)


def _text(value: str) -> bytes:
    raw = value.encode("utf-8", "surrogatepass")
    return _COUNT.pack(len(raw)) + raw


@lru_cache(maxsize=4096)
def _known_text(value: str) -> bytes:
    """Encoded form of a word that comes back every cycle (a mapping's key)."""
    return _text(value)


def layout_of(hint: Any) -> Layout:
    """Layout of one type hint used in `hil.signals`.

    Raises:
        TypeError: a hint that the codec has no rule for (found by the tests, not by a user).
    """
    simple = {int: "int", float: "float", bool: "bool", str: "str", Any: "any"}
    if hint in simple:
        return simple[hint]
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is np.ndarray:
        return "array"
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


def _types_within(hint: Any, found: dict[str, type]) -> None:
    """Collect the dataclasses and enumerations that a hint reaches."""
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or issubclass(hint, enum.Enum)):
        if hint.__name__ not in found:
            found[hint.__name__] = hint
            if dataclasses.is_dataclass(hint):
                for inner in typing.get_type_hints(hint).values():
                    _types_within(inner, found)
        return
    for inner in typing.get_args(hint):
        _types_within(inner, found)


@lru_cache(maxsize=1)
def _types() -> dict[str, type]:
    found: dict[str, type] = {}
    _types_within(CycleRecord, found)
    return found


def describe() -> dict[str, Any]:
    """Layout of a cycle record as JSON, stored in every recording."""
    classes, enums = {}, {}
    for name, kind in _types().items():
        if issubclass(kind, enum.Enum):
            enums[name] = [member.value for member in kind]
        else:
            hints = typing.get_type_hints(kind)
            classes[name] = [[f.name, layout_of(hints[f.name])] for f in dataclasses.fields(kind)]
    return {"format": FORMAT, "root": CycleRecord.__name__, "classes": classes, "enums": enums}


def _encode_array(put: Callable[[bytes], None], value: Any) -> None:
    array = np.asarray(value)
    char = _CHARS.get(array.dtype)
    if char is None:
        array = array.astype(np.int64 if array.dtype.kind in "iu" else np.float64)
        char = _CHARS[array.dtype]
    put(_SHAPES[array.ndim].pack(char, array.ndim, *array.shape))
    put(array.tobytes())


def _encode_any(put: Callable[[bytes], None], value: Any) -> None:
    """One value of a free mapping, tagged by its kind; a kind without a tag is kept as its text."""
    if value is None:
        put(b"n")
    elif isinstance(value, (bool, np.bool_)):
        put(b"b" + _FLAGS[bool(value)])
    elif isinstance(value, (int, np.integer)):
        put(b"i" + _INT.pack(int(value)))
    elif isinstance(value, (float, np.floating)):
        put(b"f" + _FLOAT.pack(float(value)))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        put(b"a")
        _encode_array(put, value)
    elif isinstance(value, (tuple, list)):
        put(b"t" + _COUNT.pack(len(value)))
        for item in value:
            _encode_any(put, item)
    elif isinstance(value, Mapping):
        put(b"m" + _COUNT.pack(len(value)))
        for key, item in value.items():
            put(_known_text(str(key)))
            _encode_any(put, item)
    else:
        put(b"s" + _text(str(value)))


_PRIMITIVE_ENCODERS: dict[str, Encode] = {
    "int": lambda put, value: put(_INT.pack(value)),
    "float": lambda put, value: put(_FLOAT.pack(value)),
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
            codes = {member: _BYTE.pack(i) for i, member in enumerate(_types()[inner])}  # type: ignore[var-annotated, arg-type]
            return lambda put, value: put(codes[value])
        return {"tuple": self._tuple, "optional": self._optional, "mapping": self._mapping}[kind](inner)

    def _class_encoder(self, name: str) -> Encode:
        fields = self._classes[name]

        def encode(put: Callable[[bytes], None], value: Any) -> None:
            for field, encode_field in fields:
                encode_field(put, getattr(value, field))

        return encode

    def _tuple(self, layout: Layout) -> Encode:
        encode_item = self._encoder(layout)

        def encode(put: Callable[[bytes], None], value: Any) -> None:
            put(_COUNT.pack(len(value)))
            for item in value:
                encode_item(put, item)

        return encode

    def _optional(self, layout: Layout) -> Encode:
        encode_value = self._encoder(layout)

        def encode(put: Callable[[bytes], None], value: Any) -> None:
            if value is None:
                put(b"\x00")
            else:
                put(b"\x01")
                encode_value(put, value)

        return encode

    def _mapping(self, layout: Layout) -> Encode:
        encode_value = self._encoder(layout)

        def encode(put: Callable[[bytes], None], value: Any) -> None:
            put(_COUNT.pack(len(value)))
            for key, item in value.items():
                put(_known_text(key))
                encode_value(put, item)

        return encode


def _decode_int(data: bytes, at: int) -> tuple[int, int]:
    return _INT.unpack_from(data, at)[0], at + 8


def _decode_float(data: bytes, at: int) -> tuple[float, int]:
    return _FLOAT.unpack_from(data, at)[0], at + 8


def _decode_bool(data: bytes, at: int) -> tuple[bool, int]:
    return data[at] != 0, at + 1


def _decode_text(data: bytes, at: int) -> tuple[str, int]:
    end = at + 4 + _COUNT.unpack_from(data, at)[0]
    if end > len(data):
        raise ValueError("a text runs beyond the end of the record")
    return data[at + 4 : end].decode("utf-8", "surrogatepass"), end


def _decode_array(data: bytes, at: int) -> tuple[Any, int]:
    dtype, shape_of = _DTYPES[data[at : at + 1]], _SHAPES[data[at + 1]]
    shape = shape_of.unpack_from(data, at)[2:]
    at += shape_of.size
    count = 1
    for length in shape:
        count *= length
    array = np.frombuffer(data, dtype, count, at) if count else np.empty(0, dtype)
    return array.reshape(shape).copy(), at + count * dtype.itemsize


def _decode_any(data: bytes, at: int) -> tuple[Any, int]:
    tag, at = data[at : at + 1], at + 1
    if tag == b"n":
        return None, at
    plain = {b"b": _decode_bool, b"i": _decode_int, b"f": _decode_float, b"s": _decode_text, b"a": _decode_array}
    if tag in plain:
        return plain[tag](data, at)  # type: ignore[operator, no-any-return]
    if tag not in (b"t", b"m"):
        raise ValueError(f"unknown tag {tag!r}")
    (count,), at = _COUNT.unpack_from(data, at), at + 4
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
