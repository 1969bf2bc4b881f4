"""Recordings whose header, notes or cycles were made up: named, never a foreign error or a hang."""

import json
import struct

import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Metadata, Schema
from mcap_cases import driving_record

from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import HilError
from hil.core.signals import CycleRecord
from hil.recording.cycle_codec import FORMAT, CycleCodec
from hil.recording.mcap_file import METADATA
from hil.recording.mcap_reader import Note, RecordingReader
from hil.recording.ros_messages import CycleMessages
from hil.recording.runs import RunStart, read_runs
from hil.recording.transform_tree import FrameTree
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from tests.selected import draws

BOUNDED = draws(15, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
SCALARS = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=6)
TREES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


def write(path, messages, header=None, number=str(FORMAT)):
    """An MCAP file whose checksums are right, whatever it holds; messages are (topic, bytes)."""
    builder = RecordBuilder()
    text = header if isinstance(header, str) else json.dumps(header)
    texts = {"header": text, "packages": "{}"} | ({} if number is None else {"format": number})
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


MESSAGES = CycleMessages((), FrameTree({}))
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
    return MESSAGES.note(0, json.dumps({"kind": kind, "data": data}))[::2]


def cycle(data):
    return MESSAGES.cycle(0, data)[::2]


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
    plays(write(tmp_path / "run.mcap", [], header))


@pytest.mark.parametrize("geometry", [[float("nan")] * 16, [0.0] * 16])
def test_a_geometry_of_no_robot_is_refused_by_file_and_key(tmp_path, capsys, geometry):
    path = write(tmp_path / "run.mcap", [], {"config": CONFIG, "geometry": geometry})
    assert main(["replay", str(path)]) == 2
    said = capsys.readouterr().err
    assert "run.mcap: has a header whose `geometry` cannot be used" in said
    assert "in your code" not in said


@pytest.mark.parametrize("text", ["[" * 100_000, "", "1" * 5000])
def test_any_header_text_ends_a_command_with_a_message(tmp_path, capsys, text):
    path = write(tmp_path / "run.mcap", [], text)
    assert main(["replay", str(path)]) == 2
    assert "run.mcap: cannot be understood" in capsys.readouterr().err


@BOUNDED
@given(at=st.integers(0, 10**6), value=st.binary(min_size=1, max_size=8))
def test_any_bytes_in_a_cycle_are_a_cycle_or_a_problem(tmp_path, at, value):
    data = bytearray(CycleCodec().encode(driving_record(3)))
    at %= len(data) - len(value)
    data[at : at + len(value)] = value
    path = write(tmp_path / "run.mcap", [note("run", START), cycle(bytes(data))], {"config": CONFIG})
    reader = RecordingReader(path)
    found = [item for item in reader.items() if isinstance(item, CycleRecord)]
    assert len(found) + len(reader.problems) == 1


@pytest.mark.parametrize("deep", [b"\x91" * 100_000, b"\x81\xa1x" * 100_000])
def test_values_within_values_without_an_end_are_refused(tmp_path, deep):
    data = CycleCodec().encode(driving_record(2))
    assert data.endswith(b"external\xc0")
    path = write(tmp_path / "run.mcap", [cycle(data[:-1] + b"\x81\xa1x" + deep)], {"config": CONFIG})
    reader = RecordingReader(path)
    assert list(reader) == []
    assert "cannot be read" in reader.problems[0]


def test_what_is_wrong_with_every_cycle_is_reported_once(tmp_path):
    path = write(tmp_path / "run.mcap", [cycle(b"\x80")] * 50, {"config": CONFIG})
    reader = RecordingReader(path)
    assert list(reader) == []
    assert len(reader.problems) == 1


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
    messages = [note(kind, data), cycle(CycleCodec().encode(driving_record(3)))]
    plays(write(tmp_path / "run.mcap", messages, {"config": CONFIG}))


@BOUNDED
@given(changes=st.dictionaries(st.sampled_from(sorted(START)), TREES, max_size=2))
def test_any_start_is_a_start_or_a_problem(tmp_path, changes):
    messages = [note("run", START | changes), cycle(CycleCodec().encode(driving_record(3)))]
    path = write(tmp_path / "run.mcap", messages, {"config": CONFIG})
    problems = []
    (run,) = read_runs(path, problems)
    assert isinstance(run.start, RunStart) != bool(problems)
    plays(path)


@BOUNDED
@given(data=st.binary(max_size=40) | st.just(b"\0\1\0\0" + struct.pack("<I", 2**31) + b"x"))
def test_any_message_bytes(tmp_path, data):
    path = write(tmp_path / "run.mcap", [("/hil/notes", data), ("/hil/cycle", data)], {"config": CONFIG})
    reader = RecordingReader(path)
    assert not [item for item in reader.items() if isinstance(item, Note)]
    assert len(reader.problems) == 2


@BOUNDED
@given(
    cut=st.integers(0, 10**6),
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=6),
)
def test_any_damage_to_a_file(tmp_path, cut, flips):
    messages = [note("run", START), *(cycle(CycleCodec().encode(driving_record(k))) for k in range(3))]
    path = write(tmp_path / "run.mcap", messages, {"config": CONFIG})
    data = bytearray(path.read_bytes())
    for at, value in flips:
        data[at % len(data)] = value
    path.write_bytes(data[: len(data) - cut % 200])
    plays(path)


@pytest.mark.parametrize(("found", "named"), [("0", "format 0"), ("2", "format 2"), (None, "format")])
def test_a_recording_of_another_format_is_refused_with_both_numbers(tmp_path, capsys, found, named):
    path = write(tmp_path / "run.mcap", [], {"config": CONFIG}, found)
    assert main(["replay", str(path), "--verify"]) == 2
    said = capsys.readouterr().err
    assert named in said
    assert found is None or f"format {FORMAT}" in said
