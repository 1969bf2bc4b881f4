"""Back from bytes to `hil.vocabulary.signals.CycleRecord`, by the layout that the recording itself carries.

A field that the file lacks gets its default; a field or status that this version does not know is
skipped and named in `notes`. Bytes that do not follow their layout raise `ValueError`.
"""

from __future__ import annotations

import dataclasses
import enum
import struct
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import groupby
from typing import Any

from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_layout import CODES, FORMAT, MAGIC, SHAPES, Layout, added_in, describe, record_types
from hil.recording.value_decoders import (
    PRIMITIVES,
    Decode,
    array_of,
    coded_tuple,
    count_at,
    decode_int,
    decode_text,
    packed,
    plain_mapping,
    plain_tuple,
)
from hil.vocabulary.errors import DataError
from hil.vocabulary.signals import CycleRecord, Inputs, Status


class StoredCycle:
    """A recorded cycle of which only the inputs are read; the rest is when somebody asks.

    Attributes:
        cycle: its number.
        inputs: what the devices delivered.
    """

    def __init__(self, cycle: int, inputs: Inputs, decoder: CycleDecoder, data: bytes, end: int) -> None:
        self.cycle, self.inputs = cycle, inputs
        self._decoder, self._data, self._end = decoder, data, end

    @cached_property
    def record(self) -> CycleRecord:
        """All of it.

        Raises:
            DataError: the bytes do not follow the layout.
        """
        try:
            return self._decoder.decode(self._data)
        except ValueError as error:
            raise DataError(f"cycle {self.cycle}", f"cannot be read ({error})") from None

    def holds(self, decision: Any) -> bool:
        """Whether exactly these bits were decided (fields `cycle_codec.DECIDED`).

        False also for a recording of another layout: then only `record` can tell.
        """
        encoder = self._decoder.encoder
        if encoder is None:
            return False
        try:
            return self._data.startswith(encoder.decided(decision), self._end)
        except (struct.error, AttributeError, TypeError):
            return False


class CycleDecoder:
    """Turns bytes back into cycle records.

    Args:
        description: what `describe` gave when the recording was written.

    Attributes:
        encoder: writes records as the recording's do; None where its layout is not today's.

    Raises:
        ValueError: the description is of a newer format, malformed, or lacks what a record needs.
        ConfigError: it needs a package that is not installed.
    """

    def __init__(self, description: Mapping[str, Any]) -> None:
        self._notes: list[str] = []
        try:
            added = added_in(description)
            self._types, self._today = record_types(added), describe(added)
            found, root = description["format"], description["root"]
            if found != FORMAT:
                raise ValueError(f"cycle format {found} is not format {FORMAT}")
            if root != CycleRecord.__name__:
                raise ValueError(f"{root} is no cycle record")
            self._layouts, self._enums = description["classes"], description["enums"]
            self._classes: dict[str, Decode] = {}
            for name in self._layouts:
                self._classes[name] = self._class_decoder(name)
            self._root = self._classes[root]
            self._head = self._fields_until(root, "inputs")
        except (KeyError, TypeError) as error:
            raise ValueError(f"the layout of the cycle records is malformed ({error!r})") from None

        self.encoder = CycleEncoder(added) if description == self._today else None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the file has and this version does not know."""
        return tuple(self._notes)

    def decode(self, data: bytes) -> CycleRecord:
        """One record.

        Raises:
            ValueError: the bytes do not follow the layout.
        """
        record, end = self._read(self._root, data)
        if end != len(data) or not isinstance(record, CycleRecord):
            raise ValueError(f"cycle record of {len(data)} bytes ends at {end}")
        return record

    def begin(self, data: bytes) -> StoredCycle:
        """One record, of which only what is needed to decide again is read.

        Raises:
            ValueError: the bytes do not follow the layout.
        """
        values, end = self._read(self._head, data)
        return StoredCycle(values["cycle"], values["inputs"], self, data, end)

    def _read(self, decode: Decode, data: bytes) -> tuple[Any, int]:
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("not a cycle record (wrong first bytes)")
        try:
            return decode(data, len(MAGIC))
        except (struct.error, IndexError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"malformed cycle record ({error})") from None

    def _fields_until(self, name: str, last: str) -> Decode:
        """Reads the first fields of a class, by name, until one of them."""
        fields = [(field, self._field(name, field, layout)) for field, layout in self._layouts[name]]
        wanted = fields[: [field for field, _ in fields].index(last) + 1]

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            values = {}
            for field, decode_field in wanted:
                values[field], at = decode_field(data, at)
            return values, at

        return decode

    def _decoder(self, layout: Layout) -> Decode:
        if isinstance(layout, str):
            return PRIMITIVES[layout]
        kind, inner = layout
        if kind == "class":
            classes = self._classes
            return lambda data, at: classes[inner](data, at)
        if kind == "enum":
            return self._enum(inner)
        if kind == "samples":
            return self._samples(inner)
        return {"tuple": self._tuple, "optional": self._optional, "mapping": self._mapping}[kind](inner)

    def _samples(self, classes: Mapping[str, str]) -> Decode:
        decoders = {kind: self._tuple(["class", name]) for kind, name in classes.items()}

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            count, at = count_at(data, at)
            samples = {}
            for _ in range(count):
                kind, at = decode_text(data, at)
                samples[kind], at = decoders[kind](data, at)
            return samples, at

        return decode

    def _field(self, name: str, field: str, layout: Layout) -> Decode:
        shape = SHAPES.get(name, {}).get(field)
        return self._decoder(layout) if shape is None else array_of(shape, f"{name}.{field}")

    def _class_decoder(self, name: str) -> Decode:
        kind = self._types.get(name, dict)
        names = [field for field, _ in self._layouts[name]]
        if not names:
            raise ValueError(f"{name} has no fields")
        _check_kinds(name, self._layouts[name], self._today)
        known = [f.name for f in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else names
        unknown = [field for field in names if field not in known]
        self._notes += [f"field {name}.{field} is of another version and was skipped" for field in unknown]
        if dataclasses.is_dataclass(kind):
            for field in dataclasses.fields(kind):
                optional = (field.default, field.default_factory) != (dataclasses.MISSING,) * 2
                if field.name not in names and not optional:
                    raise ValueError(f"the recording lacks {name}.{field.name}")

        if names == known and kind is not dict:
            return self._same_fields(kind, name)
        decoders = [self._field(name, field, layout) for field, layout in self._layouts[name]]

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            values = {}
            for field, decode_field in zip(names, decoders, strict=True):
                values[field], at = decode_field(data, at)
            return kind(**{field: value for field, value in values.items() if field not in unknown}), at

        return decode

    def _same_fields(self, kind: Any, name: str) -> Decode:
        """For a class that is today what it was; plain numbers that follow each other are taken together."""
        steps: list[tuple[struct.Struct | None, Decode]] = []
        for plain, group in groupby(self._layouts[name], key=lambda field: packed([field[1]]) is not None):
            fields = list(group)
            if plain:
                steps.append((packed([layout for _, layout in fields]), decode_int))
            else:
                steps += [(None, self._field(name, field, layout)) for field, layout in fields]

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            values: list[Any] = []
            for together, decode_field in steps:
                if together is not None:
                    values += together.unpack_from(data, at)
                    at += together.size
                else:
                    value, at = decode_field(data, at)
                    values.append(value)
            return kind(*values), at

        return decode

    def _members(self, name: str) -> list[Any]:
        """What each code of an enumeration stands for."""
        kind = self._types.get(name)
        table: list[Any] = list(self._enums[name])
        if kind is None or not issubclass(kind, enum.Enum):
            return table
        known = {member.value: member for member in kind}
        for value in table:
            note = f"{name} {value!r} is of another version, read as {Status.PROTOCOL.value!r}"
            if value not in known and note not in self._notes:
                self._notes.append(note)
        return [known.get(value, Status.PROTOCOL) for value in table]

    def _enum(self, name: str) -> Decode:
        table = self._members(name)
        return lambda data, at: (table[data[at]], at + 1)

    def _tuple(self, layout: Layout) -> Decode:
        if isinstance(layout, str) and layout in CODES:
            return plain_tuple(CODES[layout])
        if layout[:1] == ["enum"]:
            return coded_tuple(self._members(layout[1]))
        decode_item = self._decoder(layout)

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            count, at = count_at(data, at)
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
        if isinstance(layout, str) and layout in CODES:
            return plain_mapping(CODES[layout])
        decode_value = self._decoder(layout)

        def decode(data: bytes, at: int) -> tuple[Any, int]:
            count, at = count_at(data, at)
            mapping = {}
            for _ in range(count):
                key, at = decode_text(data, at)
                mapping[key], at = decode_value(data, at)
            return mapping, at

        return decode


def _check_kinds(name: str, fields: Sequence[tuple[str, Layout]], described: Mapping[str, Any]) -> None:
    """Hold the fields of a class that there is today against it: numbers are not read as something else.

    Raises:
        ValueError: a field of another kind. One that may be missing today may not have been then.
    """
    today = dict(described["classes"].get(name, []))
    for field, layout in fields:
        if field in today and today[field] not in (layout, ["optional", layout]):
            raise ValueError(f"{name}.{field} is kept as {layout!r}, which is not {today[field]!r}")
