"""Recordings as files: exact; cut off, killed, on a disk that stalls."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap_cases import PERIOD_NS, driving_record

from hil.core.errors import DataError
from hil.recording.mcap_reader import Note, RecordingReader, read_cycles, read_header
from hil.recording.mcap_writer import McapRecorder
from hil.recording.record_comparison import first_difference

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


def test_cycles_at_a_distance_are_those_of_all_cycles(recording):
    some = list(RecordingReader(recording).items(5 * PERIOD_NS))
    assert [record.cycle for record in some] == list(range(0, 220, 5))
    assert first_difference(driving_record(some[3].cycle), some[3]) is None


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


def test_a_missing_file_is_a_data_error(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        read_header(tmp_path / "nothing.mcap")


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
        recorder.write(driving_record(k % 100))
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


def run_python(code, *args, **options):
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        **options,
    )


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


@pytest.mark.real_time
def test_a_killed_process_loses_at_most_the_last_second(tmp_path):
    path, last = tmp_path / "killed.mcap", 137
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


def test_a_table_in_place_of_a_recording_names_what_takes_it(tmp_path):
    path = tmp_path / "odom_1.csv.gz"
    path.write_bytes(b"t,phi1\n0,1\n" * 10)
    with pytest.raises(DataError, match="is not an MCAP file") as caught:
        list(read_cycles(path))
    assert (caught.value.path, caught.value.exit_code) == (str(path), 2)
    assert caught.value.remedy == f"it is a table: if of a drive, hil replay {path}"
