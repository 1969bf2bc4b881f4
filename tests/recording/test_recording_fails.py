"""A run that can no longer be recorded: the robot stops, unless the operator chose to go on."""

from __future__ import annotations

import numpy as np
import pytest
from mcap_cases import driving_record

import hil
from hil.core.clock import NS_PER_S, MonotonicClock
from hil.core.errors import EXIT_ABORTED, RecordingError
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from hil.robot.trajectories import line

AHEAD = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), duration_s=4.0)

pytestmark = pytest.mark.timeout(900)  # the first process to start may compile the estimators


class Follower(Sink):
    """Sees every cycle."""

    def __init__(self):
        self.records = []

    def write(self, record: CycleRecord) -> None:
        self.records.append(record)

    def close(self) -> None:
        pass


def test_a_full_disk_stops_the_robot_with_the_next_cycle_and_it_rests(tmp_path, full_disk):
    path, follower, problems = tmp_path / "run.mcap", Follower(), []
    full_disk(400_000)
    bench = hil.open_bench("emulated", seed=4)
    recorder = McapRecorder(path, bench.header(), lossless=True, on_failure="stop")
    bench.add_sink(recorder)
    bench.add_sink(follower)
    with bench:
        with pytest.raises(RecordingError, match="No space left on device") as caught:
            bench.drive(AHEAD, start_pose=(0.0, 0.0, 0.0), hold_s=0.2)
        *cycles, last = follower.records
        lost = recorder.lost
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000_000)
        before = bench.truth().pose_body_in_wall
        assert 0.005 < before[0] < 0.09
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000_000)
        np.testing.assert_allclose(bench.truth().pose_body_in_wall[:2], before[:2], atol=5e-4)
        with pytest.raises(RecordingError):  # nor does it move again while nothing is recorded
            bench.drive(AHEAD, start_pose=(0.0, 0.0, 0.0))
        np.testing.assert_allclose(bench.truth().pose_body_in_wall[:2], before[:2], atol=1e-3)
    assert (caught.value.exit_code, caught.value.path) == (EXIT_ABORTED, str(path))
    kept = [r.cycle for r in read_cycles(path, problems)]
    assert kept == list(range(recorder.written))
    assert 100 < len(kept) < 400
    assert "ends early" in problems[0]
    assert lost == len(cycles) + 1 - len(kept)
    assert len(cycles) - len(kept) <= 51  # one open chunk: the loop ended with the cycle that found out
    (event,) = last.events
    assert (event.level, event.source) == ("error", "loop")
    assert str(path) in event.message
    assert np.array_equal(last.command.drive_velocity_rad_s, np.zeros(4))


def test_another_recording_of_the_run_says_why_it_ended_and_still_repeats(tmp_path):
    """Two disks: one takes nothing any more after a while, the other holds the whole story."""
    whole = tmp_path / "whole.mcap"

    class Failing(McapRecorder):
        def write(self, record):
            super().write(record)
            if record.cycle == 60 and record.reference is not None:
                self.failure = "pulled out"

    bench = hil.open_bench("emulated", seed=4)
    bench.add_sink(Failing(tmp_path / "failing.mcap", bench.header(), lossless=True))
    bench.add_sink(McapRecorder(whole, bench.header(), lossless=True))
    with bench, pytest.raises(RecordingError, match="pulled out"):
        bench.drive(AHEAD, start_pose=(0.0, 0.0, 0.0))
    records = list(read_cycles(whole))
    assert "pulled out" in records[-1].events[0].message
    assert verify_recording(open_recording(whole))["verdict"] == "identical"


@pytest.mark.parametrize("lossless", [True, False])
def test_a_recorder_objects_from_the_failure_on(tmp_path, full_disk, lossless):
    full_disk(100_000)
    recorder = McapRecorder(tmp_path / "run.mcap", {}, lossless=lossless, capacity=10_000)
    assert recorder.objection() is None
    for k in range(300):
        recorder.write(driving_record(k))
    recorder.rest()
    clock = MonotonicClock()
    give_up_ns = clock.now_ns() + 60 * NS_PER_S
    while recorder.objection() is None and clock.now_ns() < give_up_ns:
        clock.sleep_until_ns(clock.now_ns() + NS_PER_S // 100)
    assert "No space left" in str(recorder.objection())
    recorder.close()
    assert recorder.written + recorder.dropped + recorder.lost == 300
    assert len(list(read_cycles(recorder.path, []))) == recorder.written > 0


def test_a_disk_that_does_not_keep_up_and_a_malformed_cycle_are_objected_to(tmp_path):
    recorder = McapRecorder(tmp_path / "a.mcap", {}, lossless=False, capacity=0)
    recorder.write(driving_record(0))
    assert "does not keep up" in str(recorder.objection())
    recorder.close()
    recorder = McapRecorder(tmp_path / "b.mcap", {}, lossless=True)
    recorder.write("nonsense")
    assert "could not be encoded" in str(recorder.objection())
    recorder.close()
