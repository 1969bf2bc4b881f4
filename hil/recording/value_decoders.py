"""Single values out of the bytes of a cycle record: numbers, texts, arrays, and groups of them.

Every decoder takes the bytes and where to begin, and returns the value and where it ended. Bytes that
do not follow their layout raise `ValueError`, or what `struct` and indexing raise.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hil.recording.cycle_layout import ARRAY_HEADS, CODES, COUNT, DTYPES, FLOAT, INT, Layout

_KNOWN_KEYS = 4096

Decode = Callable[[bytes, int], "tuple[Any, int]"]


def decode_int(data: bytes, at: int) -> tuple[int, int]:
    """Whole number, 64 bits."""
    return INT.unpack_from(data, at)[0], at + 8


def decode_float(data: bytes, at: int) -> tuple[float, int]:
    """Number by its 64 bits."""
    return FLOAT.unpack_from(data, at)[0], at + 8


def decode_bool(data: bytes, at: int) -> tuple[bool, int]:
    """Truth value, one byte."""
    return data[at] != 0, at + 1


def decode_text(data: bytes, at: int) -> tuple[str, int]:
    """Text with its length before it.

    Raises:
        ValueError: the text runs beyond the end of the data.
    """
    end = at + 4 + COUNT.unpack_from(data, at)[0]
    if end > len(data):
        raise ValueError("a text runs beyond the end of the record")
    return data[at + 4 : end].decode("utf-8", "surrogatepass"), end


def count_at(data: bytes, at: int) -> tuple[int, int]:
    """Number of items that follow; each takes a byte or more.

    Raises:
        ValueError: more than there can be.
    """
    count: int = COUNT.unpack_from(data, at)[0]
    if count > len(data) - at:
        raise ValueError(f"{count} items where {len(data) - at} bytes are left")
    return count, at + 4


def _vector_heads() -> dict[bytes, tuple[np.dtype[Any], int, int]]:
    """By the head of a short vector: type, length and bytes."""
    return {
        ARRAY_HEADS[1].pack(char, 1, n): (dtype, n, n * dtype.itemsize)
        for char, dtype in DTYPES.items()
        for n in range(_SHORT)
    }


_SHORT = 9
_VECTOR_SIZE = ARRAY_HEADS[1].size
_VECTORS = _vector_heads()


def decode_array(data: bytes, at: int) -> tuple[Any, int]:
    """Array with type and shape before it; a copy, aligned and writable."""
    short = _VECTORS.get(data[at : at + _VECTOR_SIZE])
    if short is not None:
        dtype, count, size = short
        at += _VECTOR_SIZE
        return np.ndarray(count, dtype, data, at).copy(), at + size
    dtype, ndim = DTYPES[data[at : at + 1]], data[at + 1]
    shape_of = ARRAY_HEADS[ndim]
    shape = shape_of.unpack_from(data, at)[2:]
    at += shape_of.size
    array = np.ndarray(shape, dtype, data, at).copy()
    return array, at + array.nbytes


def array_of(shape: tuple[int, ...], name: str) -> Decode:
    """Arrays that must have one shape, and are of doubles as a rule; `name` is for the error."""
    double = DTYPES[b"d"]
    head = ARRAY_HEADS[len(shape)].pack(b"d", len(shape), *shape)
    skipped, size = len(head), len(head) + math.prod(shape) * double.itemsize

    def decode(data: bytes, at: int) -> tuple[Any, int]:
        if data.startswith(head, at):
            return np.ndarray(shape, double, data, at + skipped).copy(), at + size
        array, at = decode_array(data, at)
        if array.shape != shape:
            raise ValueError(f"{name} has the shape {array.shape} instead of {shape}")
        return array, at

    return decode


def decode_any(data: bytes, at: int) -> tuple[Any, int]:
    """One value of a free mapping, by its tag.

    Raises:
        ValueError: a tag that nobody writes.
    """
    tag, at = data[at : at + 1], at + 1
    if tag == b"n":
        return None, at
    plain = {b"b": decode_bool, b"i": decode_int, b"f": decode_float, b"s": decode_text, b"a": decode_array}
    if tag in plain:
        return plain[tag](data, at)
    if tag not in (b"t", b"m"):
        raise ValueError(f"unknown tag {tag!r}")
    count, at = count_at(data, at)
    if tag == b"t":
        items = []
        for _ in range(count):
            item, at = decode_any(data, at)
            items.append(item)
        return tuple(items), at
    mapping = {}
    for _ in range(count):
        key, at = decode_text(data, at)
        mapping[key], at = decode_any(data, at)
    return mapping, at


PRIMITIVES: dict[str, Decode] = {
    "int": decode_int,
    "float": decode_float,
    "bool": decode_bool,
    "str": decode_text,
    "array": decode_array,
    "any": decode_any,
}


def packed(layouts: Sequence[Layout]) -> struct.Struct | None:
    """One structure for plain numbers that follow each other; None for anything else."""
    codes = [CODES.get(layout) if isinstance(layout, str) else None for layout in layouts]
    return None if None in codes else struct.Struct("<" + "".join(map(str, codes)))


def plain_tuple(code: str) -> Decode:
    """Numbers of one kind."""
    known: dict[int, struct.Struct] = {}

    def decode(data: bytes, at: int) -> tuple[Any, int]:
        (count,), at = COUNT.unpack_from(data, at), at + 4
        whole = known.get(count)
        if whole is None:
            whole = struct.Struct(f"<{count}{code}")
            if whole.size <= len(data):
                known[count] = whole
        return whole.unpack_from(data, at), at + whole.size

    return decode


def coded_tuple(table: Sequence[Any]) -> Decode:
    """Members of an enumeration, a byte each; the same combinations come back every cycle."""
    known: dict[bytes, tuple[Any, ...]] = {}

    def decode(data: bytes, at: int) -> tuple[Any, int]:
        (count,), at = COUNT.unpack_from(data, at), at + 4
        codes = data[at : at + count]
        if len(codes) != count:
            raise ValueError("an enumeration runs beyond the end of the record")
        members = known.get(codes)
        if members is None:
            members = tuple(table[code] for code in codes)
            if len(known) < _KNOWN_KEYS:
                known[codes] = members
        return members, at + count

    return decode


def plain_mapping(code: str) -> Decode:
    """Numbers by name; the names of the mapping before are expected again, which is quicker."""
    number = struct.Struct(f"<{code}")
    expected: tuple[bytes, ...] = ()
    names: tuple[str, ...] = ()
    whole = struct.Struct("<I")

    def decode(data: bytes, at: int) -> tuple[Any, int]:
        nonlocal expected, names, whole
        if at + whole.size <= len(data):
            count, *rest = whole.unpack_from(data, at)
            if count == len(expected) and tuple(rest[::2]) == expected:
                return dict(zip(names, rest[1::2], strict=True)), at + whole.size
        (count,), at = COUNT.unpack_from(data, at), at + 4
        raw, mapping = [], {}
        for _ in range(count):
            key, end = decode_text(data, at)
            raw.append(data[at:end])
            (mapping[key],), at = number.unpack_from(data, end), end + number.size
        if len(mapping) == count <= _KNOWN_KEYS:
            expected, names = tuple(raw), tuple(mapping)
            whole = struct.Struct("<I" + "".join(f"{len(r)}s{code}" for r in raw))
        return mapping, at

    return decode
