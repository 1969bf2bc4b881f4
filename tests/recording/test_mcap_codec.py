"""The exact serialisation of cycle records: round trips, other versions, malformed bytes."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_cases import CYCLE_RECORDS, driving_record

from hil.core.device import DeviceKind
from hil.core.geometry import Array
from hil.core.signals import Stamp, Status
from hil.recording.cycle_codec import DTYPES, CycleCodec
from hil.recording.record_comparison import first_difference
from tests.selected import draws

CODEC = CycleCodec()


@draws(60)
@given(record=CYCLE_RECORDS)
def test_every_bit_comes_back(record):
    data = CODEC.encode(record)
    back = CODEC.decode(data)
    assert first_difference(record, back) is None
    assert CODEC.encode(back) == data


def test_comparison_sees_a_single_bit():
    record = driving_record(1)
    pose = record.state.pose_body_in_wall.copy()
    pose[2] = np.nextafter(pose[2], 1.0)
    other = dataclasses.replace(record, state=dataclasses.replace(record.state, pose_body_in_wall=pose))
    assert first_difference(record, other).startswith("state.pose_body_in_wall[2]: ")
    assert first_difference({"a": 0.0}, {"a": -0.0}) == "a: was 0.0, now -0.0"
    assert first_difference((1, 2), (1,)) == ": was 2 entries, now 1"
    assert first_difference(1, True) is not None
    assert first_difference(np.zeros(2), np.zeros(2, dtype=np.float32)) is not None


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
SPECIAL = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324])


@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_of_other_packages_keep_type_shape_and_bits(dtype):
    for shape in ((), (0,), (3,), (0, 3), (2, 3), (1, 2, 3, 1, 2)):
        assert_kept(dtype, shape)


def assert_kept(dtype, shape):
    codec, record = CycleCodec((KIND,)), driving_record(3)
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        field = np.resize(SPECIAL, shape).astype(dtype)
    good, bad = Cell(3.7, (Status.OK,) * 3), Cell(None, (Status.CRC, Status.OK))
    packs = (
        Pack(Stamp(1, 2, 3, 4), (good, bad), None, {}, (), field, {"a": "b"}, (Status.OK,) * 2),
        Pack(Stamp(5, 6, 7), (), bad, {"x": good, "y": bad}, (-0.0, np.nan), field.T, {}, ()),
    )
    for samples in ({}, {"packs": packs}, {"packs": ()}):
        inputs = dataclasses.replace(record.inputs, added=samples)
        measured = dataclasses.replace(record.measurements, added=samples)
        observers = {"ukf": record.state, "": record.state}
        other = dataclasses.replace(record, inputs=inputs, measurements=measured, observers=observers)
        back = codec.decode(codec.encode(other))
        assert first_difference(other, back) is None


@draws(60)
@given(cut=st.integers(0, 10**6), flip=st.integers(0, 10**6), value=st.integers(0, 255))
def test_malformed_bytes_are_value_errors_or_records(cut, flip, value):
    data = bytearray(CODEC.encode(driving_record(3)))
    with pytest.raises(ValueError):
        CODEC.decode(bytes(data[: cut % len(data)]))
    data[flip % len(data)] = value
    with contextlib.suppress(ValueError):
        assert CODEC.decode(bytes(data)).inputs is not None


def tree_of(record):
    """A record as any reader of MessagePack has it."""
    return msgspec.msgpack.decode(CODEC.encode(record))


def test_a_record_says_its_fields_by_name_to_any_reader():
    record = driving_record(3)
    tree = tree_of(record)
    assert list(tree) == [field.name for field in dataclasses.fields(record)]
    servos = tree["inputs"]["servos"][0]
    assert servos["stamp"]["t_ns"] == record.inputs.servos[0].stamp.t_ns
    assert servos["status"] == ["ok"] * 8
    angles, values = servos["position_rad"], record.inputs.servos[0].position_rad
    assert (angles.code, bytes(angles.data)) == (4, values.astype("<f8").tobytes())
    covariance = tree["state"]["covariance"]
    assert covariance.code == 8
    assert np.frombuffer(covariance.data, "<u4", 2).tolist() == [6, 6]
    np.testing.assert_array_equal(
        np.frombuffer(covariance.data, "<f8", 36, 8), record.state.covariance.ravel()
    )


def test_fields_of_another_version_are_skipped_and_missing_ones_get_their_defaults():
    record = driving_record(2)
    assert record.truth is None
    tree = tree_of(record)
    del tree["truth"], tree["inputs"]["servos"][0]["alert"]
    tree["humidity"] = tree["state"]["humidity"] = 0.4
    back = CODEC.decode(msgspec.msgpack.encode(tree))
    assert first_difference(record, back) is None


@pytest.mark.parametrize("spoil", ["field", "status", "type"])
def test_what_cannot_be_understood_is_refused_with_its_place(spoil):
    tree = tree_of(driving_record(2))
    if spoil == "field":
        del tree["state"]["twist_body"]
    elif spoil == "status":
        tree["inputs"]["servos"][0]["status"][3] = "fine"
    else:
        tree["inputs"]["t_ns"] = "noon"
    with pytest.raises(ValueError, match=r"\$\.(state|inputs\.servos\[0\]\.status\[3\]|inputs\.t_ns)"):
        CODEC.decode(msgspec.msgpack.encode(tree))
