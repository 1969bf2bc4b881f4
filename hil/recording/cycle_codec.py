"""Cycle records as MessagePack, and back: exact, typed, and readable without this package.

Every class is a map of its fields by name, every `Status` its text. An array is an extension. Its code is
four times the number of its dimensions, plus the type of its values (0 float64, 1 float32, 2 int64, 3 bool).
Its data are the values in C order, little endian; where there are several dimensions, their lengths come
before them, four bytes each. Numbers keep every bit. A field that the reader does not know is skipped; one
that a record lacks gets its default. Samples of added kinds are kept with the inputs, not again with the
measurements.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import GenericAlias
from typing import Any

import msgspec
import numpy as np

from hil.core.device import DeviceKind
from hil.core.errors import ConfigError
from hil.core.signals import CycleRecord

FORMAT = 1
"""Version of the content of the topic `/hil/cycle`; files with another number are not read."""
DTYPES: Sequence[np.dtype[Any]] = tuple(map(np.dtype, ("<f8", "<f4", "<i8", "?")))
"""Types of arrays that are kept as they are."""
_Ext = msgspec.msgpack.Ext
_FLOATS = DTYPES[0]
_NUMBERS = {dtype: number for number, dtype in enumerate(DTYPES)}


class CycleCodec:
    """Turns cycle records into bytes and back.

    Args:
        added: kinds of other packages whose samples they may hold.

    Raises:
        ConfigError: samples of one of these kinds cannot be recorded.
    """

    def __init__(self, added: tuple[DeviceKind, ...] = ()) -> None:
        for kind in added:
            _check(kind)
        self._added = {kind.name: GenericAlias(tuple, (kind.sample, ...)) for kind in added}
        self._encoder = msgspec.msgpack.Encoder(enc_hook=_packed)
        self._decoder = msgspec.msgpack.Decoder(CycleRecord, dec_hook=_array, ext_hook=_unpacked)

    def encode(self, record: CycleRecord) -> bytes:
        """Bytes of one record.

        Raises:
            TypeError, ValueError, OverflowError: it holds what cannot be recorded.
        """
        if not isinstance(record, CycleRecord):
            raise TypeError(f"{type(record).__name__} is no cycle record")
        if record.measurements.added:
            record = replace(record, measurements=replace(record.measurements, added={}))
        return self._encoder.encode(record)

    def decode(self, data: bytes) -> CycleRecord:
        """Decode one record.

        Raises:
            ValueError: the bytes are no cycle record.
        """
        try:
            record = self._decoder.decode(data)
            if record.truth is not None:
                record = replace(record, truth={key: _tuples(v) for key, v in record.truth.items()})
            if record.inputs.added:
                samples = {
                    name: msgspec.convert(found, self._added[name], dec_hook=_array)
                    for name, found in record.inputs.added.items()
                }
                measured = replace(record.measurements, added=samples)
                inputs = replace(record.inputs, added=samples)
                record = replace(record, inputs=inputs, measurements=measured)
        except (msgspec.MsgspecError, struct.error, KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"no cycle record: {error}") from None
        return record


def _packed(value: Any) -> Any:
    """Replacement for a value that MessagePack has no form for: arrays, numpy scalars, mappings."""
    if isinstance(value, np.ndarray):
        if value.dtype is _FLOATS and value.ndim == 1:  # nearly all of them
            return _Ext(4, value.tobytes())
        number, dimensions = _NUMBERS.get(value.dtype), value.ndim
        if number is None:
            return _packed(value.astype("<i8" if value.dtype.kind in "iu" else "<f8"))
        lengths = struct.pack(f"<{dimensions}I", *value.shape) if dimensions > 1 else b""
        return _Ext(4 * dimensions + number, lengths + value.tobytes())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a {type(value).__name__} cannot be recorded")


def _unpacked(code: int, data: memoryview) -> Any:
    """The array of an extension, as a copy."""
    dimensions, number = divmod(code, 4)
    values = np.frombuffer(data, DTYPES[number], offset=4 * dimensions if dimensions > 1 else 0)
    if dimensions == 1:
        return values.copy()
    return values.reshape(struct.unpack_from(f"<{dimensions}I", data) if dimensions else ()).copy()


def _array(kind: Any, value: Any) -> Any:
    """Value of an array field; a recorded number or list of numbers becomes a float64 array."""
    return value if isinstance(value, np.ndarray) else np.asarray(value, dtype=np.float64)


def _tuples(value: Any) -> Any:
    """Value of a free mapping with lists turned into tuples, the type that was recorded."""
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    return {key: _tuples(item) for key, item in value.items()} if isinstance(value, dict) else value


def _check(kind: DeviceKind) -> None:
    """Raise `ConfigError` for a kind whose samples have fields that cannot be recorded."""
    try:
        strange = {c for c in _classes(msgspec.inspect.type_info(kind.sample)) if c is not np.ndarray}
        why = ", ".join(sorted(c.__name__ for c in strange))
    except (TypeError, NameError, RecursionError) as error:
        why = str(error)
    if why:
        raise ConfigError(
            f"samples of the kind {kind.name} ({kind.package}) cannot be recorded ({why})",
            expected="fields of type int, float, bool, str, Array, Status, Stamp, a dataclass of them, "
            "X | None, tuple[X, ...] or Mapping[str, X]",
        )


def _classes(part: msgspec.Struct) -> Iterator[Any]:
    """Classes in a type description that MessagePack has no form for."""
    if isinstance(part, msgspec.inspect.CustomType):
        yield part.cls
        return
    for name in part.__struct_fields__:
        value = getattr(part, name)
        for inner in value if isinstance(value, tuple) else (value,):
            if isinstance(inner, (msgspec.inspect.Type, msgspec.inspect.Field)):
                yield from _classes(inner)
