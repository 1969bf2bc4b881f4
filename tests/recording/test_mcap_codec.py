"""The exact serialisation of cycle records: round trips, other versions, malformed bytes."""

from __future__ import annotations

import contextlib
import copy
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_cases import CYCLE_RECORDS, driving_record

from hil.recording.compare import first_difference
from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_decoder import CycleDecoder
from hil.recording.cycle_layout import FORMAT, describe
from hil.vocabulary.signals import Status


@settings(max_examples=60)
@given(record=CYCLE_RECORDS)
def test_every_bit_comes_back(record):
    data = CycleEncoder().encode(record)
    back = CycleDecoder(describe()).decode(data)
    assert first_difference(record, back) is None
    assert CycleEncoder().encode(back) == data


def test_an_encoder_that_has_seen_others_writes_the_same():
    """It remembers statuses of the record before: all well, then not, then another number of channels."""
    encoder, records = CycleEncoder(), []
    for k, status in enumerate(((Status.OK,) * 8, (Status.OK,) * 7 + (Status.CRC,), (), (Status.OK,) * 8)):
        record = driving_record(k)
        servos = tuple(dataclasses.replace(s, status=status) for s in record.inputs.servos)
        records.append(dataclasses.replace(record, inputs=dataclasses.replace(record.inputs, servos=servos)))
    for record in records:
        assert encoder.encode(record) == CycleEncoder().encode(record)


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


def test_decoded_arrays_are_their_own_memory():
    back = CycleDecoder(describe()).decode(CycleEncoder().encode(driving_record(1)))
    back.state.pose_body_in_wall[:] = 7.0
    assert back.state.twist_body[0] == 0.05


@settings(max_examples=60)
@given(cut=st.integers(0, 10**6), flip=st.integers(0, 10**6), value=st.integers(0, 255))
def test_malformed_bytes_are_value_errors_or_records(cut, flip, value):
    data = bytearray(CycleEncoder().encode(driving_record(3)))
    decoder = CycleDecoder(describe())
    with pytest.raises(ValueError):
        decoder.decode(bytes(data[: cut % len(data)]))
    data[flip % len(data)] = value
    with contextlib.suppress(ValueError):
        assert decoder.decode(bytes(data)).inputs is not None


def test_newer_fields_are_skipped_and_named():
    # A newer writer: CycleRecord gained a last field. Its bytes are ours with one more double.
    newer = copy.deepcopy(describe())
    newer["classes"]["CycleRecord"].append(["humidity", "float"])
    decoder = CycleDecoder(newer)
    record = driving_record(2)
    back = decoder.decode(CycleEncoder().encode(record) + np.float64(0.4).tobytes())
    assert first_difference(record, back) is None
    assert decoder.notes == ("field CycleRecord.humidity is of another version and was skipped",)


def test_older_recordings_get_defaults():
    older = copy.deepcopy(describe())
    assert older["classes"]["CycleRecord"].pop()[0] == "truth"
    record = driving_record(2)
    assert record.truth is None
    back = CycleDecoder(older).decode(CycleEncoder().encode(record)[:-1])
    assert first_difference(record, back) is None


def test_unknown_status_is_read_as_protocol_and_named():
    newer = copy.deepcopy(describe())
    newer["enums"]["Status"][0] = "fine"
    decoder = CycleDecoder(newer)
    back = decoder.decode(CycleEncoder().encode(driving_record(2)))
    assert back.inputs.servos[0].status == (Status.PROTOCOL,) * 8
    assert "'fine'" in decoder.notes[0]


@pytest.mark.parametrize("spoil", ["format", "root", "field", "kind"])
def test_unusable_layouts_are_refused(spoil):
    layout = copy.deepcopy(describe())
    if spoil == "format":
        layout["format"] = FORMAT + 1
    elif spoil == "root":
        del layout["root"]
    elif spoil == "field":
        layout["classes"]["Stamp"] = layout["classes"]["Stamp"][1:]
    else:
        layout["classes"]["Stamp"][0][1] = "quaternion128"
    with pytest.raises(ValueError):
        CycleDecoder(layout)


def test_free_values_without_a_tag_are_kept_as_text():
    record = dataclasses.replace(driving_record(2), truth={"what": {1, 2}.__class__})
    back = CycleDecoder(describe()).decode(CycleEncoder().encode(record))
    assert back.truth == {"what": "<class 'set'>"}
