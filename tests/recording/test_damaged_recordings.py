"""A damaged recording is called damaged, with the byte; only another robot's needs a topic mapping."""

import json
import re

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer
from mcap_cases import driving_record
from recorded import recorded

from hil.bench import open_bench
from hil.cli import main
from hil.core.errors import DataError
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_scan import records_of
from hil.recording.mcap_writer import McapRecorder
from hil.recording.record_comparison import first_difference
from hil.robot.trajectories import line


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    return recorded(path, map(driving_record, range(50)), {"config": {}}).read_bytes()


def reported(tmp_path, data):
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    with pytest.raises(DataError) as error:
        list(read_cycles(path))
    assert "topic" not in str(error.value)
    assert str(error.value).startswith(f"{path}: ")
    return error.value.message.partition(": ")[2]


@pytest.mark.parametrize("length", [8, 100, 2000])
def test_a_beginning_alone_ends_early(tmp_path, whole, length):
    assert re.match(r"ends early at byte \d+", reported(tmp_path, whole[:length]))


def test_an_empty_file_is_called_empty(tmp_path):
    assert reported(tmp_path, b"") == "is empty"


@pytest.mark.parametrize(
    ("find", "put", "message"),
    [
        (b"\x0c", b"\x2c", r"is damaged at byte 32: what says how to read it is not there"),
        (b"packages", b"pack\xffges", r"is damaged after byte 32: "),
        (b'{"config"', b'{"conf"g"', r"cannot be understood, or is damaged after byte 32 \("),
        (b"\x03\x00\x00\x00hil", b"\x03\x10\x00\x00hil", r"is damaged after byte 32: "),
    ],
    ids=["kind of a record", "text", "JSON", "length of a text"],
)
def test_flipped_bytes_of_the_head_are_damage(tmp_path, whole, find, put, message):
    at = whole.index(find, 30)
    assert re.match(message, reported(tmp_path, whole[:at] + put + whole[at + len(find) :]))


def test_rubbish_between_records_is_damage(tmp_path, whole):
    assert re.match(
        r"ends early at byte 41 \(writer killed, disk full, or damaged there\): unknown",
        reported(tmp_path, whole[:32] + b"\xee" * 200 + whole[232:]),
    )


def test_a_damaged_chunk_costs_its_own_cycles_also_where_it_describes_the_topics(tmp_path):
    path = recorded(tmp_path / "run.mcap", map(driving_record, range(200)), {"config": {}})
    data, at = path.read_bytes(), [at for at, r in records_of(path, []) if isinstance(r, Chunk)]
    all_read, found = [record.cycle for record in read_cycles(path)], []
    for begin in at:
        path.write_bytes(data[: begin + 2000] + bytes([data[begin + 2000] ^ 0xFF]) + data[begin + 2001 :])
        problems = []
        found.append({record.cycle for record in read_cycles(path, problems)})
        assert re.match(f"the chunk at byte {begin} is damaged", problems[0])
        assert len(problems) == 1
    assert len(at) > 3
    assert all(len(some) < len(all_read) for some in found)
    assert [sum(cycle in some for some in found) for cycle in all_read] == [len(at) - 1] * len(all_read)
    path.write_bytes(data[: at[0] + 2000] + b"\xff\xff" + data[at[0] + 2002 : at[-1]])  # without its summary
    problems = []
    assert list(read_cycles(path, problems)) == []
    assert any(re.match(r"\d+ messages cannot be read", problem) for problem in problems)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A recording of three runs that repeats bit for bit."""
    path = tmp_path_factory.mktemp("driven") / "run.mcap"
    bench = open_bench("emulated_floor")
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        bench.devices.actuators().enable()
        for _ in range(3):
            start = bench.settle(0.1)
            bench.drive(line(start, start + np.array([0.05, 0.0, 0.0]), duration_s=1.5), start_pose=start)
    return path.read_bytes()


def test_a_flipped_byte_is_damage_to_who_verifies_too(tmp_path, driven, capsys):
    path = tmp_path / "run.mcap"
    path.write_bytes(driven)
    assert main(["replay", str(path), "--verify"]) == 0
    at = len(driven) // 2
    path.write_bytes(driven[:at] + bytes([driven[at] ^ 0x10]) + driven[at + 1 :])
    capsys.readouterr()
    assert main(["replay", str(path), "--verify", "--json"]) == 2
    said = capsys.readouterr()
    reported = json.loads(said.out)
    assert reported["problems"]
    assert f"hil: {path}: {reported['problems'][0]}" in said.err
    assert main(["replay", str(path), "--estimator", "odometry"]) == 2


def test_what_was_readable_is_evaluated_and_the_damage_named(tmp_path, driven, capsys):
    path = tmp_path / "run.mcap"
    path.write_bytes(driven)
    assert main(["evaluate", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["problems"] == []
    path.write_bytes(driven[: len(driven) // 2])
    assert main(["evaluate", str(path), "--json"]) == 2
    said = capsys.readouterr()
    reported = json.loads(said.out)
    assert (reported["recordings"], len(reported["problems"])) == (1, 1)
    assert re.match(r"run: ends early at byte \d+", reported["problems"][0])
    assert re.search(
        r"warning: run: ends early at byte .*; its figures are of \d\.\d s that were read", said.err
    )
    assert main(["evaluate", str(path)]) == 2
    assert "1 recordings, model exact" in capsys.readouterr().out
    path.write_bytes(driven[: len(driven) // 12])
    assert main(["evaluate", str(path)]) == 2
    said = capsys.readouterr()
    assert re.search(r"ends early at byte \d+ .*; what could be read does not do: ", said.err)
    assert said.out == ""


@pytest.mark.parametrize(
    ("compression", "chunked"),
    [(CompressionType.ZSTD, True), (CompressionType.LZ4, True), (CompressionType.NONE, False)],
)
def test_a_recording_that_another_program_wrote_anew_is_read_and_its_damage_named(
    tmp_path, whole, compression, chunked
):
    """`mcap filter` and others write with other compressions, or without chunks."""
    path, anew = tmp_path / "run.mcap", tmp_path / "anew.mcap"
    path.write_bytes(whole)
    with anew.open("wb") as file:
        writer = Writer(file, chunk_size=20_000, compression=compression, use_chunking=chunked)
        copied(path, writer)
    assert first_difference(tuple(read_cycles(path)), tuple(read_cycles(anew))) is None
    data = anew.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    problems = []
    cut = [record.cycle for record in read_cycles(path, problems)]
    assert cut == list(range(len(cut)))
    assert 5 < len(cut) < 45
    assert re.match(r"ends early at byte \d+", problems[0])
    if chunked:
        at = len(data) // 2
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        problems.clear()
        read = [record.cycle for record in read_cycles(path, problems)]
        assert (read[0], read[-1]) == (0, 49)
        assert 20 < len(read) < 50
        (problem,) = problems
        assert re.match(r"the chunk at byte \d+ is damaged", problem)
        assert int(re.search(r"at byte (\d+)", problem).group(1)) < at


def copied(path, writer):
    """Write the messages and metadata of a recording by another writer."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        writer.start(profile="ros2", library="another")
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        ids = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in ids:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(
                ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
