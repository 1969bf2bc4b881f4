"""Recordings as files: exact, deterministic, opened by others; damage, kill, full and stalled disks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_cases import PERIOD_NS, driving_record
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hil.core.errors import DataError
from hil.core.registry import kinds
from hil.recording.mcap_reader import Note, RecordingReader, read_cycles, read_header
from hil.recording.mcap_writer import McapRecorder
from hil.recording.record_comparison import first_difference
from hil.recording.topics import topics_with
from tests.selected import every

HEADER = {"seed": 7, "config": {"name": "test", "rate_hz": 100.0}, "versions": {"hil": "0"}}


def write(path, cycles, *, lossless=True, header=HEADER):
    recorder = McapRecorder(path, header, lossless=lossless, capacity=10_000)
    for k in range(cycles):
        recorder.write(driving_record(k))
    recorder.close()
    return recorder


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("rec") / "run.mcap"
    write(path, 220)
    return path


@pytest.mark.parametrize("lossless", [True, False])
def test_every_cycle_comes_back_exactly(tmp_path, lossless):
    path = tmp_path / "run.mcap"
    recorder = write(path, 130, lossless=lossless)
    assert recorder.report() == {"path": str(path), "written": 130, "dropped": 0, "lost": 0, "failure": ""}
    back = list(read_cycles(path))
    assert len(back) == 130
    for k, record in enumerate(back):
        assert first_difference(driving_record(k), record) is None
    assert read_header(path) == HEADER


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write(tmp_path / name, 120)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_thread_and_caller_write_the_same_bytes(tmp_path):
    write(tmp_path / "a", 120)
    write(tmp_path / "b", 120, lossless=False)
    assert list(map(str, read_cycles(tmp_path / "a"))) == list(map(str, read_cycles(tmp_path / "b")))


def test_notes_keep_their_place_and_their_floats(tmp_path):
    recorder = McapRecorder(tmp_path / "r", {}, lossless=True)
    recorder.write(driving_record(0))
    recorder.note(5, "run", {"pose": [0.1 + 0.2, 1e-300, 3.0]})
    recorder.write(driving_record(1))
    recorder.close()
    items = list(RecordingReader(tmp_path / "r").items())
    assert isinstance(items[1], Note)
    assert (items[1].kind, items[1].data) == ("run", {"pose": [0.1 + 0.2, 1e-300, 3.0]})
    assert [items[0].cycle, items[2].cycle] == [0, 1]


def test_the_official_reader_opens_it(recording):
    with recording.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()} == topics_with(
            tuple(kinds().values())
        )
        assert summary.statistics.chunk_count >= 4
        counts = {}
        for schema, channel, _ in reader.iter_messages():
            assert schema.encoding == "ros2msg"
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts["/hil/cycle"] == counts["/odom"] == counts["/joint_states"] == 220
    assert counts["/tracker/pose"] == 440


def test_rosbags_opens_it(recording):
    with AnyReader([recording], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        joints = [c for c in bag.connections if c.topic == "/joint_states"]
        messages = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages(connections=joints)]
        assert len(messages) == 220
        assert list(messages[7].position) == list(driving_record(7).inputs.servos[0].position_rad)
        assert sum(1 for _ in bag.messages()) > 1500


def test_a_truncated_recording_gives_what_it_has(recording, tmp_path):
    whole = recording.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: len(whole) * 3 // 5])
    problems = []
    back = list(read_cycles(path, problems))
    assert 50 <= len(back) < 220
    assert all(first_difference(driving_record(k), r) is None for k, r in enumerate(back))
    assert len(problems) == 1
    assert "ends early at byte" in problems[0]
    cycles = read_cycles(path)
    assert sum(1 for _, _ in zip(range(len(back)), cycles, strict=False)) == len(back)
    with pytest.raises(DataError, match="ends early"):
        next(cycles)


def test_a_damaged_chunk_is_skipped_and_named(recording, tmp_path):
    data = bytearray(recording.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    path = tmp_path / "bad.mcap"
    path.write_bytes(data)
    problems = []
    numbers = [r.cycle for r in read_cycles(path, problems)]
    assert numbers[0] == 0
    assert numbers[-1] == 219
    assert 100 < len(numbers) < 220
    assert "damaged" in problems[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"t,phi1\n0,1\n" * 10, "is not an MCAP file"),
        (b"\x89MCAP0\r\n" + b"\xff" * 64, "ends early at byte 17"),
    ],
)
def test_foreign_files_are_refused_by_name(tmp_path, content, reason):
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    with pytest.raises(DataError, match=reason) as caught:
        list(read_cycles(path))
    assert caught.value.path == str(path)
    assert caught.value.exit_code == 2


def test_a_missing_file_is_a_data_error(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        read_header(tmp_path / "nothing.mcap")


def test_an_mcap_of_another_robot_points_to_the_topic_mapping(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    writer = Writer(str(path))
    writer.start("ros2", "other")
    writer.finish()
    with pytest.raises(DataError, match="topic mapping"):
        read_header(path)


def test_an_unwritable_place_is_a_data_error(tmp_path):
    with pytest.raises(DataError, match="cannot be written"):
        McapRecorder(tmp_path / "no" / "such" / "folder.mcap", {}, lossless=True)


def test_a_malformed_record_is_lost_and_named_and_the_rest_goes_on(tmp_path):
    recorder = McapRecorder(tmp_path / "r", {}, lossless=True)
    recorder.write(driving_record(0))
    recorder.write("nonsense")
    recorder.write(driving_record(1))
    recorder.close()
    recorder.close()
    assert (recorder.written, recorder.lost) == (2, 1)
    assert "could not be encoded" in recorder.failure
    assert [r.cycle for r in read_cycles(tmp_path / "r")] == [0, 1]


def test_the_thread_of_a_recorder_works_while_the_loop_sleeps_and_not_beside_a_cycle(tmp_path):
    recorder = McapRecorder(tmp_path / "r.mcap", {}, lossless=False)
    recorder.write(driving_record(0))
    recorder._thread.join(0.5)  # it waits for a whole half second in vain
    assert recorder.written == 0
    recorder.rest()
    recorder.write(driving_record(1))
    recorder.close()
    assert [r.cycle for r in read_cycles(tmp_path / "r.mcap")] == [0, 1]


def test_a_disk_that_stalls_costs_records_and_no_time(tmp_path):
    # A pipe that is not emptied is a disk that does not answer: the writer blocks inside the kernel.
    path = tmp_path / "stalled.mcap"
    os.mkfifo(path)
    reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    recorder = McapRecorder(path, {}, lossless=False, capacity=50)
    for k in range(2000):
        recorder.write(driving_record(k))
    assert recorder.dropped > 1000
    os.set_blocking(reading, True)
    drained = []

    def drain():
        while data := os.read(reading, 1 << 16):
            drained.append(data)

    draining = threading.Thread(target=drain)
    draining.start()
    recorder.close()
    draining.join()
    os.close(reading)
    (tmp_path / "copy.mcap").write_bytes(b"".join(drained))
    back = list(read_cycles(tmp_path / "copy.mcap"))
    assert len(back) == recorder.written == 2000 - recorder.dropped


FULL_DISK = """
import resource, sys
from mcap_cases import driving_record
from hil.recording.mcap_writer import McapRecorder
recorder = McapRecorder(sys.argv[1], {}, lossless=sys.argv[2] == "lossless", capacity=10000)
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
for k in range(400):
    recorder.write(driving_record(k))
recorder.close()
print(recorder.written, recorder.dropped, recorder.lost, recorder.failure)
"""


def run_python(code, *args, **options):
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.parametrize("mode", ["lossless", "thread"])
def test_a_full_disk_ends_the_recording_and_not_the_loop(tmp_path, mode):
    path = tmp_path / "full.mcap"
    with run_python(FULL_DISK, path, mode, stderr=subprocess.DEVNULL) as process:
        out = process.communicate(timeout=600)[0]
    assert process.returncode == 0
    written, dropped, lost, failure = out.strip().split(" ", 3)
    assert "File too large" in failure
    assert int(written) + int(dropped) + int(lost) == 400
    problems = []
    back = list(read_cycles(path, problems))
    assert len(back) == int(written) > 0
    assert problems
    assert path.stat().st_size <= 150_000


KILLED = """
import sys
from mcap_cases import PERIOD_NS, driving_record
from hil.core.clock import MonotonicClock
from hil.recording.mcap_writer import McapRecorder
recorder = McapRecorder(sys.argv[1], {}, lossless=False)
clock = MonotonicClock()
start = clock.now_ns()
for k in range(10**6):
    clock.sleep_until_ns(start + k * PERIOD_NS)
    recorder.write(driving_record(k))
    recorder.rest()
    print(k, flush=True)
"""


@pytest.mark.parametrize("last", every(2, [137, 211]))
def test_a_killed_process_loses_at_most_the_last_second(tmp_path, last):
    path = tmp_path / "killed.mcap"
    with run_python(KILLED, path) as process:
        for line in process.stdout:
            if int(line) >= last:
                break
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
    assert process.returncode == -signal.SIGKILL
    final = int(rest[-1]) if rest and rest[-1].isdigit() else last
    problems = []
    back = list(read_cycles(path, problems))
    assert [r.cycle for r in back] == list(range(len(back)))
    assert (final - back[-1].cycle) * PERIOD_NS <= 1_000_000_000
    assert problems


@pytest.mark.parametrize("name", ["odom_1.csv", "odom_1.csv.gz"])
def test_a_table_in_place_of_a_recording_names_what_takes_it(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"t,phi1\n0,1\n" * 10)
    with pytest.raises(DataError, match="is not an MCAP file") as caught:
        list(read_cycles(path))
    assert caught.value.remedy == f"it is a table: if of a drive, hil replay {path}"
