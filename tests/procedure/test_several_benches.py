"""A robot that one bench did not hold is an error of the run, whatever the benches after it say."""

import json
from functools import partial

import pytest

from hil.bench.hold.held_state import Held
from hil.cli import main
from hil.core.clock import NS_PER_S, MonotonicClock
from hil.core.errors import Aborted, SafetyStop
from hil.faults.fault import parse_fault
from hil.procedure import Measurement, procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.final_hold import HoldRecord
from hil.procedure.interrupts import Interrupts
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.run_journal import Journal, read_journal
from hil.procedure.run_sinks import StepTimer
from hil.procedure.runner import RunOptions, run_procedure
from hil.procedure.tracking_errors import enable_hold
from hil.report.run_page import write_run_page
from hil.robot.trajectories import line
from tests.procedure.in_turn import InTurn

WHY = "adhesion is lost"
MEASURED = (Measurement("done", "1", low=1.0),)


def fall(bench):
    soon_s = bench.clock.now_ns() / NS_PER_S + 0.5
    bench.world.faults.add(parse_fault(f"plant:adhesion_loss@{soon_s},over_s=0.5"))
    with pytest.raises(SafetyStop):
        bench.drive(line((0, 0, 0), (0.05, 0, 0), duration_s=5.0), feedback="odometry")


def ran(folder, proc, *, resume=False):
    source = BenchSource("emulated", overrides={"exit.look_after_s": 2.0})
    options = RunOptions(folder, MonotonicClock(), "2026-01-01T00:00:00", {}, resume=resume)
    result = run_procedure(proc, source, options)
    return result, json.loads((folder / "result.json").read_text())


@procedure(name="one_after_the_other", needs=("servos",), measurements=MEASURED)
def one_after_the_other(ctx):
    """Falls from the first bench, stands on the second."""
    fall(ctx.reopen("falls"))
    enable_hold(ctx.reopen("stands"), 0.1)
    ctx.measure("done", True)


@pytest.fixture(scope="module")
def fell(tmp_path_factory):
    """Folder, result and what was reported of a run whose first robot fell."""
    folder = tmp_path_factory.mktemp("fell") / "run"
    return folder, *ran(folder, one_after_the_other)


def test_a_bench_that_did_not_hold_is_named_though_the_next_one_held(fell):
    folder, result, reported = fell
    assert (result.verdict.value, result.exit_code) == ("ERROR", 3)
    (problem,) = reported["teardown_errors"]
    assert problem["type"] == "NotHeld"
    assert problem["message"].startswith("bench 1 (falls): ")
    assert reported["held"]["state"] == "NOT HELD"
    page = write_run_page(folder).read_text()
    assert "NOT HELD" in page
    assert "bench 1 (falls)" in page
    kept = [(e["bench"], e["state"]) for e in read_journal(folder / "journal.jsonl").held]
    assert kept == [("bench 1 (falls)", "NOT HELD"), ("bench 2 (stands)", "HELD")]


@procedure(name="ends_early", needs=("servos",), measurements=MEASURED)
def ends_early(ctx):
    """Falls, and is stopped on the next bench."""
    fall(ctx.reopen("falls"))
    enable_hold(ctx.reopen("stands"), 0.1)
    raise Aborted("the operator has seen it")


def test_what_is_worse_stays_the_verdict_and_a_note_names_the_bench(tmp_path):
    result, reported = ran(tmp_path / "run", ends_early)
    assert (result.verdict.value, result.exit_code, reported["held"]["state"]) == ("ABORTED", 4, "NOT HELD")
    assert any(note.startswith("NOT HELD: bench 1 (falls): ") and WHY in note for note in reported["notes"])


def stood(bench):
    enable_hold(bench, 0.1)


@procedure(name="elsewhere", needs=("servos",), measurements=MEASURED)
def elsewhere(ctx):
    """Falls in one process; benches in others and its own hold."""
    jobs = [DriveJob(ctx.source, drive, label) for label, drive in (("falls", fall), ("stands", stood))]
    list(ctx.at_once(jobs, InTurn()))
    enable_hold(ctx.reopen("own"), 0.1)
    ctx.measure("done", True)


def test_a_robot_that_fell_in_another_process_is_not_forgotten_either(tmp_path):
    result, reported = ran(tmp_path / "run", elsewhere)
    assert (result.exit_code, reported["held"]["state"]) == (3, "NOT HELD")
    (problem,) = reported["teardown_errors"]
    assert problem["message"].startswith("bench 1 (falls): ")


def twice(*, fails):
    @procedure(name="twice", needs=("servos",), measurements=MEASURED)
    def twice(ctx):
        ctx.checkpoint("falls", lambda: fall(ctx.reopen("falls")))
        ctx.checkpoint("stands", partial(second, ctx))
        ctx.measure("done", True)

    def second(ctx):
        enable_hold(ctx.reopen("stands"), 0.1)
        if fails:
            raise KeyboardInterrupt

    return twice


def test_a_resumed_run_knows_what_a_bench_of_a_finished_checkpoint_left(tmp_path):
    assert ran(tmp_path / "run", twice(fails=True))[0].verdict.value == "ABORTED"
    result, reported = ran(tmp_path / "run", twice(fails=False), resume=True)
    assert (result.verdict.value, result.exit_code, reported["held"]["state"]) == ("ERROR", 3, "NOT HELD")
    (problem,) = reported["teardown_errors"]
    assert problem["message"].startswith("bench 1 (falls), before this run was resumed: ")


def left(tmp_path, past=(), finished=()):
    guard = StepTimer(Interrupts())
    return guard, HoldRecord(Journal(tmp_path / "journal.jsonl"), guard, past, finished)


FALLEN = Held("NOT HELD", 0.6, WHY)
HOLDS = Held("HELD", 0.001, "torque on")


def entries(tmp_path):
    return [json.loads(row) for row in (tmp_path / "journal.jsonl").read_text().splitlines()]


def test_what_a_repeated_checkpoint_left_before_does_not_count(tmp_path):
    guard, benches = left(tmp_path)
    for title, finished in (("first", True), ("second", False)):
        benches.enter(title)
        name = benches.begin(title)
        guard.driven_ns += 10
        benches.leave(finished=finished)
        benches.add(name, FALLEN, tethered=False)
    past = entries(tmp_path)
    assert [e["checkpoint"] for e in past] == ["first", ""]
    assert [b.name for b in left(tmp_path, past, ["first"])[1].not_held] == [
        "bench 1 (first), before this run was resumed"
    ]
    assert left(tmp_path, past, [])[1].not_held == []


def test_a_bench_that_was_driven_on_belongs_to_the_checkpoint_that_drove_it_last(tmp_path):
    guard, benches = left(tmp_path)
    benches.enter("first")
    name = benches.begin()
    benches.leave(finished=True)
    benches.enter("second")
    guard.driven_ns += 10
    benches.add(name, FALLEN, tethered=False)
    benches.leave(finished=False)
    assert [e["checkpoint"] for e in entries(tmp_path)] == ["second"]


def test_a_robot_on_a_tether_may_slide_unless_it_is_the_last_word(tmp_path):
    """The search for the heading at which a robot slides lets it slide, bench after bench."""
    _, benches = left(tmp_path)
    benches.add("slides", FALLEN, tethered=True)
    assert (benches.held, len(benches.not_held)) == (FALLEN, 1)
    benches.add("holds", HOLDS, tethered=True)
    assert (benches.held, benches.not_held) == (HOLDS, [])


def test_a_robot_that_was_let_go_is_no_error(tmp_path):
    _, benches = left(tmp_path)
    released = Held("NOT HELD", None, "released", wanted=False)
    benches.add("released", released, tethered=False)
    assert (benches.held, benches.not_held) == (released, [])


def test_the_list_of_results_says_that_a_robot_was_not_held(fell, capsys):
    assert main(["results", "list", "--in", str(fell[0].parent)]) == 0
    assert f"bench 1 (falls): the accelerometer feels less than the weight: {WHY}" in capsys.readouterr().out
