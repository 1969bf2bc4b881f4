"""The generated encoder writes what a walk over the layout, value by value, writes."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_cases import CYCLE_RECORDS, driving_record

from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_layout import MAGIC, describe
from hil.recording.value_encoders import FEW
from hil.vocabulary.device import DeviceKind
from hil.vocabulary.geometry import Array
from hil.vocabulary.signals import Event, Stamp, Status

PLAIN = {"int": "<q", "float": "<d", "bool": "<?"}
CHARS = {"f8": b"d", "f4": b"f", "i8": b"q", "b1": b"?"}


@dataclasses.dataclass(frozen=True)
class Cell:
    """An inner value of a package's sample."""

    volt: float | None
    status: tuple[Status, ...]


@dataclasses.dataclass(frozen=True)
class Pack:
    """A sample that has every kind of field."""

    stamp: Stamp
    cells: tuple[Cell, ...]
    spare: Cell | None
    named: Mapping[str, Cell]
    rows: tuple[float, ...]
    field: Array
    words: Mapping[str, str]
    status: tuple[Status, ...]


class Packs(DeviceKind):
    name, noun, sample, models = "packs", "battery", Pack, ()


KIND = Packs()


def count(value):
    return struct.pack("<I", len(value))


def text(value):
    raw = value.encode("utf-8", "surrogatepass")
    return count(raw) + raw


def array(value):
    head = struct.pack(f"<cB{value.ndim}I", CHARS[value.dtype.str[1:]], value.ndim, *value.shape)
    return head + value.tobytes()


def free(value):
    if value is None:
        return b"n"
    if isinstance(value, tuple):
        return b"t" + count(value) + b"".join(map(free, value))
    if isinstance(value, dict):
        return b"m" + count(value) + b"".join(text(key) + free(item) for key, item in value.items())
    if isinstance(value, np.ndarray):
        return b"a" + array(value)
    kinds = {bool: (b"b", "<?"), int: (b"i", "<q"), float: (b"f", "<d")}
    if type(value) in kinds:
        tag, form = kinds[type(value)]
        return tag + struct.pack(form, value)
    return b"s" + text(value)


def walked(layout, value, described):
    """Bytes of one value, found by asking its layout."""
    if isinstance(layout, str):
        others = {"str": text, "array": array, "any": free}
        return struct.pack(PLAIN[layout], value) if layout in PLAIN else others[layout](value)
    kind, inner = layout
    if kind == "class":
        fields = described["classes"][inner]
        return b"".join(walked(of, getattr(value, field), described) for field, of in fields)
    if kind == "enum":
        return bytes([described["enums"][inner].index(value.value)])
    if kind == "optional":
        return b"\0" if value is None else b"\1" + walked(inner, value, described)
    if kind == "tuple":
        return count(value) + b"".join(walked(inner, item, described) for item in value)
    of = {key: ["tuple", ["class", inner[key]]] if kind == "samples" else inner for key in value}
    return count(value) + b"".join(text(k) + walked(of[k], item, described) for k, item in value.items())


def whole(record, added=()):
    described = describe(added)
    return MAGIC + walked(["class", described["root"]], record, described)


@settings(max_examples=60)
@given(record=CYCLE_RECORDS)
def test_records_are_written_as_their_layout_says(record):
    assert CycleEncoder().encode(record) == whole(record)


@settings(max_examples=30)
@given(records=st.lists(CYCLE_RECORDS, min_size=2, max_size=4))
def test_what_an_encoder_remembers_of_records_before_changes_nothing(records):
    encoder = CycleEncoder()
    assert [encoder.encode(record) for record in records * 2] == [whole(record) for record in records * 2]


@pytest.mark.parametrize("many", [FEW - 1, FEW, FEW + 1])
def test_any_number_of_items_is_counted(many):
    record = driving_record(3)
    events = tuple(Event(k, "info", "here", "") for k in range(many))
    samples = record.inputs.imu[:1] * many
    other = dataclasses.replace(record, events=events, inputs=dataclasses.replace(record.inputs, imu=samples))
    assert CycleEncoder().encode(other) == whole(other)


def test_samples_of_other_packages_and_other_estimators_are_too():
    encoder, record = CycleEncoder((KIND,)), driving_record(3)
    good, bad = Cell(3.7, (Status.OK,) * 3), Cell(None, (Status.CRC, Status.OK))
    packs = [
        Pack(Stamp(1, 2, 3, 4), (good, bad), None, {}, (), np.zeros((0, 2)), {"a": "b"}, (Status.OK,) * 2),
        Pack(Stamp(5, 6, 7), (), bad, {"x": good, "y": bad}, (1.0, np.nan), np.eye(3)[::2, 1:], {}, ()),
    ]
    for samples in ({}, {"packs": tuple(packs)}, {"packs": ()}):
        other = dataclasses.replace(
            record,
            inputs=dataclasses.replace(record.inputs, added=samples),
            observers={"ukf": record.state, "": record.state},
        )
        assert encoder.encode(other) == whole(other, (KIND,))


@pytest.mark.parametrize(
    "given",
    [
        [0.5, 1.0, 2.0],
        np.arange(3),
        np.arange(3, dtype=np.float32),
        np.ones(3) > 0,
        np.ones(4),
        np.ones((3, 1)),
        np.ones((0, 3)),
        np.float64(1.0),
    ],
)
def test_arrays_of_other_types_and_shapes_are_written_as_what_they_are(given):
    record = driving_record(3)
    other = dataclasses.replace(record, state=dataclasses.replace(record.state, twist_body=given))
    same = dataclasses.replace(record, state=dataclasses.replace(record.state, twist_body=np.asarray(given)))
    assert CycleEncoder().encode(other) == whole(same)


@pytest.mark.parametrize(
    "wrong", [{"cycle": "seven"}, {"state": None}, {"events": (Event(1, "info", 2, ""),)}, {"observers": ()}]
)
def test_what_is_no_record_is_refused(wrong):
    with pytest.raises((struct.error, AttributeError, TypeError)):
        CycleEncoder().encode(dataclasses.replace(driving_record(3), **wrong))
