"""Recordings whose header, layout, notes or cycles were made up: named, never a foreign error or a hang."""

import copy
import dataclasses
import json
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Metadata, Schema
from mcap_cases import driving_record

from hil.cli import main
from hil.config.loading import load_bench
from hil.recording.cdr import octet_array, string
from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_decoder import CycleDecoder
from hil.recording.cycle_layout import COUNT, MAGIC, describe
from hil.recording.mcap_file import METADATA
from hil.recording.mcap_reader import Note, RecordingReader
from hil.recording.runs import RunStart, read_runs
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from hil.vocabulary.errors import HilError
from hil.vocabulary.signals import CycleRecord, RobotState

BOUNDED = settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)
SCALARS = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=6)
TREES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
KINDS = st.sampled_from(
    ["int", "float", "bool", "str", "array", "any", "Stamp", "CycleRecord", "Status", "nothing"]
)
LAYOUTS = st.recursive(
    KINDS | SCALARS,
    lambda inner: (
        st.tuples(st.sampled_from(["tuple", "optional", "mapping", "class", "enum"]), inner | KINDS).map(list)
        | st.lists(inner, max_size=3)
    ),
    max_leaves=5,
)


def write(path, messages, header=None, layout=None):
    """An MCAP file whose checksums are right, whatever it holds; messages are (topic, bytes)."""
    builder = RecordBuilder()
    texts = {"header": header, "layout": layout}
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in texts.items()}
    topics = ("/hil/cycle", "/hil/notes")
    chunk = RecordBuilder()
    Schema(data=b"", encoding="", id=1, name="x").write(chunk)
    for number, topic in enumerate(topics):
        Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=1).write(chunk)
    for topic, data in messages:
        Message(channel_id=topics.index(topic), data=data, log_time=0, publish_time=0, sequence=0).write(
            chunk
        )
    builder.write(b"\x89MCAP0\r\n")
    Header(profile="", library="").write(builder)
    Metadata(name=METADATA, metadata=texts).write(builder)
    records = chunk.end()
    Chunk("", records, 0, 0, 0, len(records)).write(builder)
    DataEnd(0).write(builder)
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    builder.write(b"\x89MCAP0\r\n")
    path.write_bytes(builder.end())
    return path


CONFIG = load_bench("emulated").model_dump(mode="json", by_alias=True)
STATE = {"t_ns": 0, "pose_body_in_wall": [0] * 3, "twist_body": [0] * 3, "covariance": [[0] * 6] * 6}
START = {"state": STATE, "feedback": "odometry", "controller": None, "observers": [], "trajectory": None}


ARC = {
    "kind": "arc",
    "law": "constant",
    "duration_s": 1,
    "path": {"start": [0, 0, 0], "radius_m": "x", "angle_rad": 1},
}


def note(kind, data):
    return ("/hil/notes", string(json.dumps({"kind": kind, "data": data})))


def cycle(data):
    return ("/hil/cycle", octet_array(data))


def plays(path):
    """Everything that a command does with a recording, up to the estimators."""
    error = None
    try:
        verify_recording(open_recording(path))
    except HilError as refused:
        error = refused
    assert error is None or error.exit_code == 2


@BOUNDED
@given(
    header=st.dictionaries(
        st.sampled_from(["config", "geometry", "tyres", "seed", "versions", "name"]), TREES
    )
)
@example(header={"config": CONFIG, "seed": "x"})
@example(header={"config": CONFIG, "seed": 1e400})
@example(header={"config": CONFIG, "geometry": [1, 2], "tyres": 3})
@example(header={"config": CONFIG, "geometry": [0.1] * 16, "tyres": {"evil": 3}})
@example(header={"config": CONFIG, "versions": [1]})
@example(header={"config": []})
@example(header=[1])
def test_any_header(tmp_path, header):
    plays(write(tmp_path / "run.mcap", [], header, describe()))


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "1", "", "1" * 5000])
def test_any_header_text_ends_a_command_with_a_message(tmp_path, capsys, text):
    for header, layout in ((text, describe()), ({"config": CONFIG}, text)):
        path = write(tmp_path / "run.mcap", [], header, layout)
        assert main(["replay", str(path)]) == 2
        assert "run.mcap: cannot be understood" in capsys.readouterr().err


@BOUNDED
@given(
    name=st.sampled_from(sorted(describe()["classes"])),
    field=st.integers(0, 30),
    layout=LAYOUTS,
    rest=st.sampled_from(["replace", "drop", "add", "empty"]),
)
@example(name="Stamp", field=0, layout=["class", "Stamp"], rest="add")
@example(name="Inputs", field=0, layout="str", rest="replace")
@example(name="CycleRecord", field=0, layout=["tuple", ["class", "Event"]], rest="replace")
def test_any_layout(name, field, layout, rest):
    description = copy.deepcopy(describe())
    fields = description["classes"][name]
    at = field % len(fields)
    if rest == "replace":
        fields[at][1] = layout
    elif rest == "add":
        fields.insert(at, ["new", layout])
    else:
        del fields[at if rest == "drop" else 0 :]
    try:
        decoder = CycleDecoder(description)
        assert isinstance(decoder.decode(CycleEncoder().encode(driving_record(3))), CycleRecord)
    except ValueError:
        pass


@BOUNDED
@given(data=st.data(), at=st.integers(0, 10**6), value=st.binary(min_size=1, max_size=8))
def test_any_bytes_in_a_cycle(tmp_path, data, at, value):
    good = bytearray(CycleEncoder().encode(driving_record(3)))
    at %= len(good) - len(value)
    good[at : at + len(value)] = value
    path = write(
        tmp_path / "run.mcap", [note("run", START), cycle(bytes(good))], {"config": CONFIG}, describe()
    )
    plays(path)


def test_a_count_of_items_that_cannot_be_there_ends_at_once():
    description = copy.deepcopy(describe())
    description["classes"]["CycleRecord"].append(["new", ["tuple", ["class", "Nothing"]]])
    description["classes"]["Nothing"] = []
    with pytest.raises(ValueError, match="Nothing has no fields"):
        CycleDecoder(description)
    whole = CycleEncoder().encode(driving_record(3))
    description["classes"]["Nothing"] = [["x", "bool"]]
    with pytest.raises(ValueError, match="4294967295 items where"):
        CycleDecoder(description).decode(whole + COUNT.pack(2**32 - 1) + bytes(100))


def test_values_within_values_without_an_end_are_refused():
    nested = b"t" + COUNT.pack(1)
    record = CycleEncoder().encode(driving_record(2))
    assert record.endswith(b"\0")  # no truth
    with pytest.raises(ValueError, match="malformed"):
        CycleDecoder(describe()).decode(
            record[:-1] + b"\1" + COUNT.pack(1) + COUNT.pack(1) + b"a" + nested * 50_000
        )
    description = copy.deepcopy(describe())
    description["classes"]["Stamp"].append(["inner", ["class", "Stamp"]])
    with pytest.raises(ValueError, match="malformed"):
        CycleDecoder(description).decode(MAGIC + bytes(100_000))


def test_arrays_have_the_shapes_that_are_promised(tmp_path):
    record = dataclasses.replace(
        driving_record(1), state=RobotState(0, np.zeros(2), np.zeros(3), np.zeros((6, 6)))
    )
    path = write(
        tmp_path / "run.mcap", [cycle(CycleEncoder().encode(record))], {"config": CONFIG}, describe()
    )
    reader = RecordingReader(path)
    assert list(reader) == []
    assert "RobotState.pose_body_in_wall has the shape (2,) instead of (3,)" in reader.problems[0]


@BOUNDED
@given(kind=st.just("run") | SCALARS, data=TREES)
@example(kind="run", data={**START, "controller": [1]})
@example(kind="run", data={**START, "trajectory": "x"})
@example(kind="run", data={**START, "observers": [[1]]})
@example(kind="run", data={**START, "feedback": "evil"})
@example(kind="run", data={**START, "state": STATE | {"t_ns": 1e400}})
@example(kind="run", data={**START, "trajectory": {"name": "x", "segments": [ARC]}})
@example(kind=[], data={})
def test_any_note(tmp_path, kind, data):
    messages = [note(kind, data), cycle(CycleEncoder().encode(driving_record(3)))]
    plays(write(tmp_path / "run.mcap", messages, {"config": CONFIG}, describe()))


@BOUNDED
@given(changes=st.dictionaries(st.sampled_from(sorted(START)), TREES, max_size=2))
def test_any_start_is_a_start_or_a_problem(tmp_path, changes):
    messages = [note("run", START | changes), cycle(CycleEncoder().encode(driving_record(3)))]
    path = write(tmp_path / "run.mcap", messages, {"config": CONFIG}, describe())
    problems = []
    (run,) = read_runs(path, problems)
    assert isinstance(run.start, RunStart) != bool(problems)
    plays(path)


@BOUNDED
@given(data=st.binary(max_size=40) | st.just(b"\0\1\0\0" + struct.pack("<I", 2**31) + b"x"))
def test_any_message_bytes(tmp_path, data):
    path = write(
        tmp_path / "run.mcap", [("/hil/notes", data), ("/hil/cycle", data)], {"config": CONFIG}, describe()
    )
    reader = RecordingReader(path)
    assert not [item for item in reader.items() if isinstance(item, Note)]
    assert len(reader.problems) == 2


@BOUNDED
@given(
    cut=st.integers(0, 10**6),
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=6),
)
def test_any_damage_to_a_file(tmp_path, cut, flips):
    messages = [note("run", START), *(cycle(CycleEncoder().encode(driving_record(k))) for k in range(3))]
    path = write(tmp_path / "run.mcap", messages, {"config": CONFIG}, describe())
    data = bytearray(path.read_bytes())
    for at, value in flips:
        data[at % len(data)] = value
    path.write_bytes(data[: len(data) - cut % 200])
    plays(path)
