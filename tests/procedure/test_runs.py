"""From the function to the verdict: what every run leaves, whatever happens in it."""

import io
import json
import os
import signal
from dataclasses import dataclass
from xml.etree import ElementTree

import pytest
from matplotlib.figure import Figure

from hil.cli.run import text_of
from hil.core.errors import Aborted, ConfigError, DeviceError, UsageError
from hil.procedure import Measurement, procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts, time_limit
from hil.procedure.operator import Answers, Terminal
from hil.report.run_page import write_run_page
from tests.patience import FANLESS

LIMITS = (Measurement("good", "mm", high=10.0, rationale="because"), Measurement("seen", "s"))


@dataclass(frozen=True)
class Gain:
    gain: float = 1.0


@procedure(name="small", parameters=Gain, measurements=LIMITS)
def small(ctx):
    """Measures twice."""
    with ctx.step("one"):
        ctx.measure("good", 4.0 * ctx.parameters.gain)
    with ctx.step("two"):
        ctx.measure("seen", 1)
    ctx.table("Table", ["a", "b"], [[1.23456, True]])
    ctx.note("a sentence")


def result_of(result):
    return json.loads((result.folder / "result.json").read_text())


def test_a_run_leaves_its_result_as_json_and_junit(run_small):
    result = run_small(small)
    tree = result_of(result)
    assert (tree["schema"], tree["verdict"], tree["exit_code"]) == (1, "PASS", 0)
    assert [m["outcome"] for m in tree["measurements"]] == ["PASS", "PASS"]
    assert tree["measurements"][0] | {} == tree["measurements"][0]
    assert tree["measurements"][0]["margin"] == 6.0
    assert tree["measurements"][0]["step"] == "one"
    assert [s["outcome"] for s in tree["steps"]] == ["done", "done"]
    assert tree["tables"][0]["rows"] == [["1.235", "yes"]]
    for key in (
        "config",
        "calibration",
        "seed",
        "versions",
        "git_revision",
        "duration_s",
        "bench",
        "started",
    ):
        assert key in tree, key
    suite = ElementTree.parse(result.folder / "junit.xml").getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "0", "0")
    assert {p.get("name") for p in suite.iter("property")} >= {"bench", "calibration_version"}
    properties = {entry.get("name"): entry.get("value") for entry in suite.iter("property")}
    assert properties["virtual_time"] == "true"
    assert properties["emulated"] == (",".join(result.facts["emulated"]) or "none")
    assert properties.get("held") == (result.facts["held"] or {}).get("state")


def test_a_limit_decides_the_exit_code(run_small):
    result = run_small(small, parameters={"gain": "3"})
    assert (result.verdict.value, result.exit_code) == ("FAIL", 1)
    suite = ElementTree.parse(result.folder / "junit.xml").getroot()
    assert [f.get("message") for f in suite.iter("failure")] == ["12 mm, expected <= 10 mm"]


def test_what_was_declared_and_never_set_fails(run_small):
    @procedure(name="forgetful", measurements=LIMITS)
    def forgetful(ctx):
        ctx.measure("good", 1.0)

    result = run_small(forgetful)
    assert result.exit_code == 1
    assert [m["outcome"] for m in result.measurements] == ["PASS", "FAIL"]


@pytest.mark.parametrize(
    ("error", "verdict", "code"),
    [
        (DeviceError("imu", "is dead"), "ERROR", 3),
        (UsageError("nonsense"), "ERROR", 2),
        (Aborted("enough"), "ABORTED", 4),
        (ZeroDivisionError("division by zero"), "ERROR", 2),
        (KeyboardInterrupt("from a library"), "ABORTED", 4),
        (SystemExit("the script left"), "ERROR", 2),
    ],
)
def test_an_error_ends_in_a_verdict_that_names_it_and_the_step(run_small, error, verdict, code):
    @procedure(name="broken", measurements=LIMITS)
    def broken(ctx):
        with ctx.step("fine"):
            ctx.measure("good", 1.0)
        with ctx.step("outer"), ctx.step("bad"):
            raise error

    result = run_small(broken)
    tree = result_of(result)
    assert (tree["verdict"], result.exit_code) == (verdict, code)
    assert tree["error"]["step"] == "bad"
    assert str(error) in tree["error"]["message"]
    assert [m["outcome"] for m in tree["measurements"]] == ["PASS", "NOT MEASURED"]
    assert ElementTree.parse(result.folder / "junit.xml").getroot().get("errors") == "1"


def test_teardown_runs_backwards_whatever_happened_and_cannot_hide_the_first_error(run_small):
    order = []

    @procedure(name="careful")
    def careful(ctx):
        ctx.on_teardown(lambda: order.append("first"), "first")
        ctx.on_teardown(lambda: 1 // 0, "bad teardown")
        ctx.on_teardown(lambda: order.append("last"), "last")
        raise DeviceError("servos", "lost")

    result = run_small(careful)
    assert order == ["last", "first"]
    assert result.error.kind == "DeviceError"
    assert [(e.kind, e.step) for e in result.teardown_errors] == [("ZeroDivisionError", "bad teardown")]
    assert result.exit_code == 3


def test_a_failing_teardown_alone_is_an_error(run_small):
    @procedure(name="untidy")
    def untidy(ctx):
        ctx.on_teardown(lambda: 1 // 0, "tidy up")

    result = run_small(untidy)
    assert (result.verdict.value, result.exit_code) == ("ERROR", 2)


def test_a_teardown_that_hangs_is_cut_off(run_small):
    @procedure(name="hanging", teardown_s=0.05)
    def hanging(ctx):
        def for_ever():
            while True:
                pass

        ctx.on_teardown(for_ever, "for ever")

    result = run_small(hanging)
    assert [(e.kind, e.step) for e in result.teardown_errors] == [("StepTimeoutError", "for ever")]


@pytest.mark.parametrize("others_s", [0.0, 100.0])
def test_a_time_limit_gives_the_timer_back_after_its_block(others_s):
    running = signal.setitimer(signal.ITIMER_REAL, others_s)
    try:
        with time_limit(30.0, "block"):
            assert 20.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 30.0
        left_s = signal.getitimer(signal.ITIMER_REAL)[0]
    finally:
        signal.setitimer(signal.ITIMER_REAL, *running)
    assert left_s <= others_s
    assert left_s > others_s - 20.0
    assert (left_s > 0.0) == (others_s > 0.0)


def kill_self(number):
    os.kill(os.getpid(), number)


@procedure(name="three_steps", measurements=(Measurement("last", "1"),))
def three_steps(ctx):
    """Raises whatever signals its answers name in its second step."""
    with ctx.step("one"):
        pass
    with ctx.step("two"):
        for name in ctx.prompt("signals").split():
            kill_self(getattr(signal, name))
        ctx.note("finished the step")
    with ctx.step("three"):
        ctx.measure("last", 1.0)


@pytest.mark.parametrize(
    ("signals", "finished"),
    [("SIGINT", True), ("SIGINT SIGINT", False), ("SIGTERM", False), ("SIGHUP", False)],
)
def test_a_signal_finishes_the_step_or_stops_at_once(run_small, tmp_path, signals, finished):
    before = signal.getsignal(signal.SIGINT)
    answers = tmp_path / "answers.txt"
    answers.write_text(f"# for this test\nsignals: {signals}\n")
    result = run_small(three_steps, operator=Answers(answers))
    tree = result_of(result)
    assert (tree["verdict"], result.exit_code) == ("ABORTED", 4)
    assert ("finished the step" in tree["notes"]) == finished
    assert [s["title"] for s in tree["steps"]] == ["one", "two"]
    assert (tree["error"]["step"], tree["error"]["finished"]) == ("two", finished)
    assert signals.split()[-1] in tree["error"]["message"]
    assert ("STOP" in tree["error"]["message"]) == (signals == "SIGTERM")
    if finished:
        assert "after the step 'two', which was finished" in tree["error"]["message"]
        assert "what they measure, are left out" in tree["error"]["message"]
        assert "ABORTED: three_steps. It ended early, after 'two': ended by Ctrl-C" in text_of(result)
        assert "after “two”" in write_run_page(result.folder).read_text()
    assert signal.getsignal(signal.SIGINT) is before


def test_what_fails_between_two_steps_is_reported_after_the_last_of_them(run_small):
    @procedure(name="torn")
    def torn(ctx):
        """Fails between its steps."""
        with ctx.step("one"):
            pass
        raise ValueError("no lamp")

    assert run_small(torn).error.place == "after 'one'"


def test_a_closed_terminal_ends_nothing_under_nohup(run_small, tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        answers = tmp_path / "answers.txt"
        answers.write_text("signals: SIGHUP\n")
        assert run_small(three_steps, operator=Answers(answers)).exit_code == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_waits_for_the_end_of_what_must_be_whole():
    interrupts = Interrupts()
    with interrupts.deferred():
        interrupts.handle(signal.SIGTERM)
    with pytest.raises(Aborted, match="SIGTERM"):
        interrupts.stop_here()


def test_figures_are_not_waited_for_after_a_further_signal():
    told, drawn = [], []
    interrupts = Interrupts(told.append)
    with interrupts.deferred(), interrupts.left_out_on_request("drawing"):
        interrupts.handle(signal.SIGINT)
        drawn.append("of a run that nobody had ended")
    with interrupts.deferred(), interrupts.left_out_on_request("drawing"):
        drawn.append("the first")
        interrupts.handle(signal.SIGINT)
        drawn.append("the second")
    assert drawn == ["of a run that nobody had ended", "the first"]
    assert [line.startswith("drawing") for line in told] == [False, True, True]
    assert interrupts.stopping() is None, "what comes after is kept"


class StruckPart:
    """A part of the emulated world in whose action the process gets a signal, 0.2 s after the start."""

    def __init__(self, world):
        self.begun = self.finished = 0
        self._due_ns = world.now_ns + 200_000_000

    def next_due_ns(self):
        return self._due_ns

    def on_due(self, t_ns):
        self._due_ns = t_ns + 10_000_000
        self.begun += 1
        os.kill(os.getpid(), signal.SIGTERM)
        self.finished += 1


def test_a_signal_divides_no_action_of_an_emulated_device(run_small):
    """Else the device is in a state that no device is ever in, when the robot is held at the end."""
    parts = []

    @procedure(name="struck", needs=("servos",))
    def struck(ctx):
        parts.append(StruckPart(ctx.bench.world))
        ctx.bench.world.add(parts[0])
        ctx.bench.observe(1.0, feedback="odometry")

    result = run_small(struck, source=BenchSource("emulated", seed=1, overrides=FANLESS))
    assert (result.verdict, result.exit_code) == ("ABORTED", 4)
    assert parts[0].begun == parts[0].finished > 0
    assert not result.teardown_errors


@pytest.mark.parametrize("keep", ["all", "results"])
def test_an_evaluation_that_was_interrupted_is_done_again(run_small, keep):
    @procedure(name="evaluated")
    def evaluated(ctx):
        seen = [1]

        def evaluate():
            ctx.note("one seen")
            ctx.table("First", ["seen"], [[len(seen)]])
            ctx.figure(Figure, "Drawn")
            if len(seen) == 1:
                seen.append(2)
                os.kill(os.getpid(), signal.SIGTERM)
            ctx.table("Second", ["seen"], [[len(seen)]])

        ctx.on_early_end(evaluate)
        with ctx.step("evaluate"):
            evaluate()

    result = run_small(evaluated, keep=keep)
    tree = result_of(result)
    assert (tree["verdict"], tree["teardown_errors"]) == ("ABORTED", [])
    assert [(t["title"], t["rows"]) for t in tree["tables"]] == [("First", [["2"]]), ("Second", [["2"]])]
    assert [f["title"] for f in tree["figures"]] == (["Drawn"] if keep == "all" else [])
    assert tree["notes"].count("one seen") == 1


def test_a_prompt_without_anybody_aborts(run_small, tmp_path, monkeypatch):
    answers = tmp_path / "none.txt"
    answers.write_text("\n")
    assert run_small(three_steps, operator=Answers(answers)).exit_code == 4
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(Aborted, match="--answers"):
        Terminal().ask("ready?")


def test_answers_are_found_by_question_then_by_order(tmp_path):
    path = tmp_path / "answers.txt"
    path.write_text("yes\nsecond question: 42\nno\n")
    operator = Answers(path)
    assert [operator.ask(q) for q in ("first?", "second question", "third?")] == ["yes", "42", "no"]
    with pytest.raises(ConfigError, match=r"missing\.txt"):
        Answers(tmp_path / "missing.txt")


def test_an_undeclared_measurement_is_an_error_that_names_the_declared(run_small):
    @procedure(name="loose", measurements=LIMITS)
    def loose(ctx):
        ctx.measure("godo", 1.0)

    result = run_small(loose)
    assert result.exit_code == 2
    assert "good, seen" in result.error.message


def test_a_device_that_the_bench_lacks_is_named_before_anything_happens(run_small, tmp_path):
    @procedure(name="needy", needs=("servos", "mocap"))
    def needy(ctx):
        raise AssertionError("must not run")

    folder = tmp_path / "needy"
    with pytest.raises(ConfigError, match="servos, mocap") as caught:
        run_small(needy, folder)
    assert caught.value.exit_code == 2
    assert not folder.exists()


def test_results_are_never_overwritten(run_small, tmp_path):
    run_small(small, tmp_path / "same")
    with pytest.raises(ConfigError, match="another run"):
        run_small(small, tmp_path / "same")


def test_a_procedure_sees_its_verdict_so_far(run_small):
    seen = []

    @procedure(
        name="looking", measurements=(Measurement("a", "1", high=10.0, marginal=2.0), Measurement("b", "1"))
    )
    def looking(ctx):
        for value in (1.0, 9.0, 11.0):
            ctx.measure("a", value)
            seen.append((ctx.verdict().value, ctx.passing()))
        ctx.measure("b", 1.0)

    run_small(looking)
    assert seen == [("PASS", True), ("MARGINAL", True), ("FAIL", False)]
