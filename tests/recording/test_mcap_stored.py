"""Cycles held against decisions as bytes: no changed bit passes, and what is equal is never read."""

import copy
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from mcap_cases import CYCLE_RECORDS, driving_record

from hil.recording.compare import first_difference
from hil.recording.cycle_codec import DECIDED, CycleEncoder
from hil.recording.cycle_decoder import CycleDecoder
from hil.recording.cycle_layout import describe
from hil.recording.mcap_reader import Note, RecordingReader
from hil.recording.mcap_writer import McapRecorder
from hil.vocabulary.errors import DataError
from hil.vocabulary.signals import CycleRecord

ENCODER, DECODER = CycleEncoder(), CycleDecoder(describe())


def stored(record):
    return DECODER.begin(ENCODER.encode(record))


def test_what_is_decided_follows_the_inputs_without_a_gap():
    names = [f.name for f in dataclasses.fields(CycleRecord)]
    at = names.index("inputs") + 1
    assert tuple(names[at : at + len(DECIDED)]) == DECIDED


@settings(max_examples=60)
@given(record=CYCLE_RECORDS)
def test_a_stored_cycle_holds_what_was_recorded(record):
    cycle = stored(record)
    assert cycle.cycle == record.cycle
    assert first_difference(record.inputs, cycle.inputs) is None
    assert cycle.holds(record)
    assert first_difference(record, cycle.record) is None


def leaves(value, path=()):
    """Paths of all arrays and floats below a value."""
    if isinstance(value, (np.ndarray, float)):
        yield path
    elif dataclasses.is_dataclass(value):
        for f in dataclasses.fields(value):
            yield from leaves(getattr(value, f.name), (*path, f.name))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from leaves(item, (*path, k))
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, (*path, key))


def changed(value, path):
    """The value with the last bit of one array's last entry, or of one float, turned."""
    if not path:
        out = np.array(value, dtype=np.float64)
        out.reshape(-1).view(np.int64)[-1] ^= 1
        return out if isinstance(value, np.ndarray) else float(out)
    name, *rest = path
    if dataclasses.is_dataclass(value):
        return dataclasses.replace(value, **{name: changed(getattr(value, name), rest)})
    if isinstance(value, tuple):
        return (*value[:name], changed(value[name], rest), *value[name + 1 :])
    return {**value, name: changed(value[name], rest)}


def test_no_single_changed_bit_is_held():
    record = driving_record(7)
    cycle, seen = stored(record), 0
    for path in leaves(record):
        other = changed(record, path)
        assert cycle.holds(other) == (path[0] not in DECIDED), path
        seen += path[0] in DECIDED
    assert seen > 20


def test_numbers_of_another_kind_or_order_are_left_to_the_record():
    record = driving_record(7)
    figures = {"a": 1.0, "b": 2.0}
    state = dataclasses.replace(record.state, diagnostics=figures)
    cycle = stored(dataclasses.replace(record, state=state))
    turned = dataclasses.replace(state, diagnostics={"b": 2.0, "a": 1.0})
    assert not cycle.holds(dataclasses.replace(record, state=turned))
    assert first_difference(cycle.record.state, turned) is None
    assert not cycle.holds(dataclasses.replace(record, setpoint=None))


def test_a_recording_of_another_layout_is_always_read():
    description = copy.deepcopy(describe())
    description["classes"]["Event"].append(["colour", "str"])
    record = dataclasses.replace(driving_record(7), events=())
    cycle = CycleDecoder(description).begin(ENCODER.encode(record))
    assert not cycle.holds(record)
    assert first_difference(record, cycle.record) is None


def test_damage_behind_the_inputs_is_an_error_when_it_is_read():
    data = ENCODER.encode(driving_record(7))
    cycle = DECODER.begin(data[:-9])
    with pytest.raises(DataError, match="cycle 7: cannot be read"):
        _ = cycle.record


def test_the_reader_gives_stored_cycles_and_notes_in_their_order(tmp_path):
    recorder = McapRecorder(tmp_path / "r", {}, lossless=True)
    recorder.note(0, "run", {"k": 1})
    written = [driving_record(k) for k in range(5)]
    for record in written:
        recorder.write(record)
    recorder.close()
    note, *cycles = RecordingReader(tmp_path / "r").stored()
    assert isinstance(note, Note)
    assert [c.cycle for c in cycles] == [r.cycle for r in written]
    assert all(c.holds(r) for c, r in zip(cycles, written, strict=True))
    assert not cycles[0].holds(written[1])
