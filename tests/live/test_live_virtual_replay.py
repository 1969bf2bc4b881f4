"""Recordings of virtual time repeat bit for bit, and what does not repeat is named by cycle and field."""

from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.core.errors import DataError, SafetyStop, UsageError
from hil.recording.mcap_writer import McapRecorder
from hil.recording.runs import RecordedRun, RunStart
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run
from hil.robot.trajectories import line

STRAIGHT = line((0.0, 0.0, 0.0), (0.04, 0.01, 0.0), duration_s=1.2)

pytestmark = pytest.mark.timeout(900)  # the first process to start may compile the estimators


def record(
    path, *faults, observers=("ukf", "odometry"), controller="optimal", trajectory=STRAIGHT, overrides=None
):
    bench = hil.open_bench("emulated", seed=4, faults=faults, overrides=overrides)
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        bench.drive(trajectory, observers=observers, controller=controller, hold_s=0.2)
    return path


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Settling and a drive with late, missing and bad samples on the way."""
    path = tmp_path_factory.mktemp("virtual") / "drive.mcap"
    return open_recording(record(path, "imu:off@1.2+0.3", "tracker:delayed@1.4+0.3"))


def test_every_run_of_a_virtual_recording_repeats(drive):
    reported = [verify_run(drive.bench, run) for run in drive.runs]
    assert [r["difference"] for r in reported] == [None, None]
    assert [r["references"] for r in reported] == ["none", "computed"]
    assert drive.problems == []


def test_a_recording_of_servos_that_were_asked_ahead_repeats(tmp_path):
    opened = open_recording(record(tmp_path / "ahead.mcap", overrides={"servos.prefetch": True}))
    assert opened.bench.config.servos.prefetch is True
    reported = [verify_run(opened.bench, run) for run in opened.runs]
    assert [r["difference"] for r in reported] == [None, None]


def test_a_loop_made_by_hand_says_in_its_recording_how_it_began(tmp_path):
    path = tmp_path / "loop.mcap"
    bench = hil.open_bench("emulated", seed=4)
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        start = RunStart(bench.start_state(), "ekf")
        loop = bench.make_loop(bench.make_pipeline(None, feedback="ekf"), start)
        for cycles in (30, 60):  # going on is no new beginning
            loop.run(lambda record, last=cycles: record.cycle >= last)
    (run,) = open_recording(path).runs
    reported = verify_run(open_recording(path).bench, run)
    assert (reported["cycles"], reported["difference"]) == (61, None)


def test_a_changed_input_is_named_by_cycle_and_field(drive):
    run = drive.run(1)
    number = next(k for k, r in enumerate(run.records) if k > 20 and r.inputs.servos[-1].ok)
    spoilt = run.records[number]
    (sample,) = spoilt.inputs.servos
    angle = np.nextafter(sample.position_rad, np.inf)
    inputs = replace(spoilt.inputs, servos=(replace(sample, position_rad=angle),))
    records = (*run.records[:number], replace(spoilt, inputs=inputs), *run.records[number + 1 :])
    found = verify_run(drive.bench, RecordedRun(run.start, records))["difference"]
    assert found.startswith(f"cycle {spoilt.cycle}: measurements.wheels.0.wheel_angle_rad[0]")


def test_another_controller_and_a_gap_are_named(drive):
    run = drive.run(1)
    other = replace(run.start, controller="nonlinear")
    found = verify_run(drive.bench, RecordedRun(other, run.records))["difference"]
    assert "setpoint" in found
    records = (*run.records[:30], *run.records[31:])
    found = verify_run(drive.bench, RecordedRun(run.start, records))
    assert found["difference"] == f"cycle {run.records[31].cycle}: the cycles before it are missing"


def test_a_run_that_ended_in_a_stop_repeats_with_its_stop(tmp_path):
    path = tmp_path / "stop.mcap"
    with pytest.raises(SafetyStop):
        record(path, "servos:off@1.5", observers=(), controller=None)
    opened = open_recording(path)
    assert [verify_run(opened.bench, run)["difference"] for run in opened.runs] == [None, None]
    assert "stale_servos" in list(opened.runs)[-1].records[-1].events[-1].message


def test_what_is_not_there_is_named(drive, tmp_path):
    with pytest.raises(UsageError, match="no run 7"):
        drive.run(7)
    path = tmp_path / "empty.mcap"
    recorder = McapRecorder(path, drive.header, lossless=True)
    recorder.close()
    with pytest.raises(DataError, match="no cycles"):
        open_recording(path).run()
