"""A step's time limit is on the bench's clock: while the loop runs, and while something waits."""

import json

import pytest

from hil.core.clock import nanoseconds
from hil.core.errors import StepTimeoutError
from hil.procedure import procedure
from hil.procedure.bench_source import BenchSource
from tests.patience import FANLESS


@pytest.fixture(scope="module")
def source():
    return BenchSource("emulated", seed=1, overrides=FANLESS)


def wait(bench, duration_s):
    bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(duration_s))


def steps_of(result):
    tree = json.loads((result.folder / "result.json").read_text())
    return {step["title"]: (step["outcome"], step["bench_s"]) for step in tree["steps"]}


def test_time_outside_the_loop_counts(run_small, source):
    @procedure(name="waiting")
    def waiting(ctx):
        bench = ctx.bench
        with ctx.step("in time", timeout_s=3.0):
            wait(bench, 2.0)
        with ctx.step("a little late", timeout_s=3.0):
            wait(bench, 3.5)

    result = run_small(waiting, source=source)
    assert (result.error.kind, result.error.step) == ("StepTimeoutError", "a little late")
    assert result.error.message == "step 'a little late' took longer than 3 s"
    assert steps_of(result) == {"in time": ("done", 2.0), "a little late": ("failed", 3.5)}
    assert result.to_json()["held"]["state"] == "HELD"


def test_who_waits_for_ever_is_ended_by_the_clock(run_small, source):
    @procedure(name="patient")
    def patient(ctx):
        bench = ctx.bench
        with ctx.step("outer", timeout_s=4.0), ctx.step("inner"):
            while True:
                wait(bench, 0.5)

    result = run_small(patient, source=source)
    assert (result.error.kind, result.exit_code) == ("StepTimeoutError", 3)
    assert result.error.message == "step 'outer' took longer than 4 s"
    assert steps_of(result)["outer"] == ("failed", pytest.approx(5.0, abs=0.01))
    assert result.to_json()["held"]["state"] == "HELD"


def test_one_long_sleep_is_ended_in_the_middle_and_once(run_small, source):
    seen = []

    @procedure(name="swallowing")
    def swallowing(ctx):
        bench = ctx.bench
        with ctx.step("sleep", timeout_s=3.0):
            try:
                wait(bench, 100.0)
            except StepTimeoutError:
                seen.append(ctx.guard.passed_s)
            wait(bench, 0.5)
            seen.append(ctx.guard.passed_s)

    result = run_small(swallowing, source=source)
    assert seen == pytest.approx([4.0, 4.5], abs=0.01)
    assert result.error.message == "step 'sleep' took longer than 3 s"


def test_a_checkpoint_that_took_too_long_is_not_kept_as_finished(run_small, source, tmp_path):
    waits_s = [4.0, 1.0]

    def work(ctx):
        wait(ctx.reopen(), waits_s.pop(0))
        return len(waits_s)

    @procedure(name="checked")
    def checked(ctx):
        assert ctx.checkpoint("one", lambda: work(ctx), timeout_s=3.5) == 0

    assert run_small(checked, tmp_path / "r", source=source).error.kind == "StepTimeoutError"
    assert run_small(checked, tmp_path / "r", source=source, resume=True).exit_code == 0
    assert waits_s == []


def test_closing_a_bench_and_opening_the_next_is_not_the_time_of_a_step(run_small, source):
    @procedure(name="reopening")
    def reopening(ctx):
        with ctx.step("two benches", timeout_s=3.0):
            wait(ctx.bench, 1.0)
            wait(ctx.reopen(), 1.5)

    result = run_small(reopening, source=source)
    assert result.exit_code == 0
    assert steps_of(result) == {"two benches": ("done", 2.5)}


def test_what_is_no_trajectory_is_reported(run_small, source):
    @procedure(name="nothing")
    def nothing(ctx):
        ctx.bench.drive(None)

    error = run_small(nothing, source=source).error
    assert (error.kind, error.exit_code) == ("UsageError", 2)
    assert error.message.startswith(
        "None is no trajectory; expected a hil.robot.trajectories.Trajectory; make one"
    )
