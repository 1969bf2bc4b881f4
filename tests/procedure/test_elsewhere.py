"""Benches driven in worker processes: the same recordings, the same word on how the robot was left."""

import json
from contextlib import closing
from functools import partial

import pytest

from hil.core.errors import Aborted, DataError, TrajectoryError
from hil.faults.files import read_faults
from hil.procedure import procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.measurements import Verdict
from hil.procedure.parallel_benches import DriveJob, Sent, driven
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.tracking_errors import enable_hold
from hil.recording.runs import read_runs
from hil.report.figure_rows import DrivenRows
from tests.patience import FANLESS
from tests.procedure.in_turn import InTurn

SHORT = {
    "cases": ["y_line"],
    "feedbacks": ["odometry", "ekf"],
    "optimal": False,
    "length_m": 0.06,
    "duration_s": 2.0,
    "hold_s": 0.5,
}


@pytest.fixture(scope="module", autouse=True)
def without_topics():
    """Worker processes write them, so this one does, too."""


@pytest.fixture
def tracked(run_small):
    def run(processes, *faults):
        """Result and what was reported of two lines on a wall."""
        source = BenchSource("emulated", seed=3, faults=read_faults(faults), overrides=FANLESS)
        parameters = {**SHORT, "processes": processes}
        result = run_small(load_procedure("wall_tracking"), source=source, parameters=parameters)
        return result, json.loads((result.folder / "result.json").read_text())

    return run


def test_two_processes_leave_what_one_leaves(tracked):
    """Recordings to the byte, how the robot was left, and for how long it drove."""
    (alone, one), (together, two) = tracked(1), tracked(2)
    names = ["recording_y_line_odometry_seed_3.mcap", "recording_y_line_ekf_seed_3.mcap"]
    assert one["recordings"] == two["recordings"] == names
    for name in names:
        assert (alone.folder / name).read_bytes() == (together.folder / name).read_bytes()
    assert one["held"]["state"] == "HELD"
    assert one["held"] == two["held"]
    assert one["measurements"] == two["measurements"]
    assert one["notes"] == two["notes"]
    assert [f["title"] for f in one["figures"]] == [f["title"] for f in two["figures"]]
    assert two["bench_duration_s"] == pytest.approx(one["bench_duration_s"], abs=0.05)


@pytest.mark.long
def test_what_ends_a_drive_in_a_worker_ends_the_run_and_its_recording_is_kept(tracked):
    result, reported = tracked(2, "tracker:unplug@1")
    assert result.verdict is Verdict.ERROR, result.error
    assert "tracker" in result.error.message
    assert reported["recordings"][0] == "recording_y_line_odometry_seed_3.mcap"
    assert reported["held"]["state"] == "HELD"
    assert sum(1 for _ in read_runs(result.folder / reported["recordings"][0])) > 0


def sent(drive, recording=None, on_failure="stop"):
    return Sent(DriveJob(BenchSource("emulated_floor"), drive, "line"), recording, on_failure)


def asked_too_much(bench):
    enable_hold(bench, 0.1)
    raise TrajectoryError("too fast", t_s=1.5, quantity="wheel speed (m/s)", value=9.0, limit=3.5)


def stood(bench, for_s):
    enable_hold(bench, for_s)
    return for_s


def test_an_error_of_the_bench_comes_back_with_how_it_was_left(tmp_path):
    found = driven(sent(asked_too_much, tmp_path / "recording.mcap"))
    assert isinstance(found.error, TrajectoryError)
    assert found.held.state == "not needed"
    assert found.driven_s == pytest.approx(0.1, abs=0.02)
    assert found.lost == ""
    assert (tmp_path / "recording.mcap").stat().st_size > 0


def test_a_recording_that_cannot_begin_ends_the_drive_unless_it_may_go_on(tmp_path):
    nowhere = tmp_path / "missing" / "recording.mcap"
    refused = driven(sent(partial(stood, for_s=0.1), nowhere))
    assert isinstance(refused.error, DataError)
    assert refused.result is None
    gone_on = driven(sent(partial(stood, for_s=0.1), nowhere, "go-on"))
    assert (gone_on.error, gone_on.result) == (None, 0.1)
    assert "recording.mcap" in gone_on.lost


def test_rows_of_another_bench_follow_in_time_and_stay_few():
    first, second = DrivenRows(10**8), DrivenRows(10**8)
    for k in range(3000):
        first.add(k * 10**8, float(k))
        second.add(k * 10**8, float(-k))
    first.follow(second)
    times = [row[0] for row in first.rows]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(2 * 299.9, abs=0.25)
    assert len(first.rows) <= 4096
    assert first.begin_anew(0)


class Struck:
    """Workers of which the run hears once, and then gets a signal."""

    def at_once(self, work, jobs):
        yield work(jobs[0])
        raise Aborted("stopped at once")


def test_a_run_that_is_stopped_meanwhile_does_not_say_that_nothing_was_opened(run_small):
    @procedure(name="two_errands")
    def two_errands(ctx):
        jobs = [DriveJob(ctx.source, partial(stood, for_s=0.1), label) for label in ("first", "second")]
        for for_s in ctx.at_once(jobs, Struck()):
            assert for_s == 0.1

    result = run_small(two_errands, source=BenchSource("emulated"))
    reported = json.loads((result.folder / "result.json").read_text())
    assert result.verdict is Verdict.ABORTED
    assert reported["held"]["state"] == "NOT HELD"
    assert "the process that drove it" in reported["held"]["why"]
    assert reported["recordings"] == ["recording_first.mcap"]
    assert reported["bench_duration_s"] == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize(("asked_for", "verdict"), [(2, Verdict.PASS), (1, Verdict.ERROR)])
def test_a_run_that_has_heard_of_all_drives_need_not_ask_for_more(run_small, asked_for, verdict):
    """Closed after the last result, the generator was not broken off; before it, it was."""

    @procedure(name="two_errands")
    def two_errands(ctx):
        jobs = [DriveJob(ctx.source, partial(stood, for_s=0.1), label) for label in ("first", "second")]
        with closing(ctx.at_once(jobs, InTurn())) as results:
            for _ in range(asked_for):
                assert next(results) == 0.1

    result = run_small(two_errands, source=BenchSource("emulated", overrides=FANLESS))
    assert result.verdict is verdict, result.error
    assert ("NotHeld" in {e.kind for e in result.teardown_errors}) is (verdict is Verdict.ERROR)
