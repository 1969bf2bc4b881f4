"""Every run says in its result, its recording and its page whether it left the robot held."""

import json
import os
import signal
from contextlib import suppress
from html import unescape

import pytest

from hil.bench.hold.held_state import held_in_words
from hil.bench.hold.hold_check import HoldMonitor
from hil.cli import main
from hil.cli.run import text_of
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceTimeoutError
from hil.faults.files import read_faults
from hil.procedure import Measurement, procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.runner import RunOptions, run_procedure
from hil.recording.mcap_reader import RecordingReader
from hil.report import run_page
from hil.report.run_page import write_run_page
from hil.robot.trajectories import line


def ran(folder, proc, source=None):
    """The result of a run in virtual time."""
    options = RunOptions(folder, MonotonicClock(), "now", {})
    result = run_procedure(proc, source or BenchSource("emulated"), options)
    return result, json.loads((folder / "result.json").read_text())


@procedure(name="climb", needs=("servos",), measurements=(Measurement("last", "1"),))
def climb(ctx):
    """Ten centimetres up."""
    ctx.bench.drive(line((0, 0, 0), (0.1, 0, 0), duration_s=3.0))
    ctx.bench.clock.sleep_until_ns(ctx.bench.clock.now_ns() + 2_000_000_000)
    ctx.measure("last", 1.0)


@pytest.mark.parametrize(
    ("faults", "state", "verdict", "said"),
    [
        ((), "HELD", "PASS", "at rest by"),
        pytest.param(("servos:brownout@7+0.3",), "HELD", "PASS", "at rest by", marks=pytest.mark.long),
        (("servos:off@7",), "NOT HELD", "ERROR", "no servo answers"),
        pytest.param(("servos:off@2",), "NOT HELD", "ERROR", "no servo answers", marks=pytest.mark.long),
        pytest.param(
            ("servo.steer_FR:off@7",), "NOT HELD", "ERROR", "steer_FR (ID 8", marks=pytest.mark.long
        ),
    ],
)
def test_a_result_says_whether_the_robot_is_held(tmp_path, faults, state, verdict, said):
    source = BenchSource("emulated", seed=1, faults=read_faults(faults), overrides={"exit.look_after_s": 1.0})
    result, tree = ran(tmp_path / "run", climb, source)
    assert (tree["held"]["state"], tree["verdict"]) == (state, verdict)
    assert said in tree["held"]["why"]
    assert result.exit_code == (0 if verdict == "PASS" else 3)
    assert (tree["held"]["moved_m"] > 0.003) == any(fault.startswith("servos:") for fault in faults)
    page = write_run_page(tmp_path / "run").read_text()
    assert state in page
    for error in tree["teardown_errors"]:
        assert error["message"] in tree["said"]
        assert error["message"] in unescape(page).partition('class="lead"')[2].partition("</p>")[0]
        assert error["message"] in text_of(result).splitlines()[-2]
    assert bool(tree["teardown_errors"]) == (verdict == "ERROR")
    (note,) = (
        n
        for n in RecordingReader(tmp_path / "run" / "recording.mcap").items()
        if getattr(n, "kind", "") == "held"
    )
    assert note.data == tree["held"]


@procedure(name="stands", needs=("servos",), measurements=())
def stands(ctx):
    """Looks on for a moment."""
    ctx.bench.observe(0.5, feedback="odometry")


@pytest.mark.parametrize("missed", [[], ["imu:off@1000"]])
def test_a_fault_that_the_run_ended_before_is_named(tmp_path, caplog, missed):
    source = BenchSource("emulated_floor", faults=read_faults(("tracker:stuck@0.6+0.1", *missed)))
    result, reported = ran(tmp_path / "run", stands, source)
    assert (result.exit_code, reported["faults_not_met"]) == (0, missed)
    notes = [note for note in reported["notes"] if "never acted" in note]
    assert len(notes) == len(missed)
    assert "is left" not in caplog.text
    last = next(line for line in text_of(result).splitlines() if line.startswith("PASS"))
    assert ("imu:off@1000" in last) == bool(missed)
    if missed:
        assert "fault imu:off@1000 never acted: the bench was closed at " in notes[0]
        assert "imu:off@1000 never acted" in write_run_page(tmp_path / "run").read_text()


@procedure(name="waits", needs=("servos",), measurements=())
def waits(ctx):
    """Looks on for a moment, some seconds after the bench was opened."""
    ctx.bench.clock.sleep_until_ns(ctx.bench.clock.now_ns() + 3_000_000_000)
    ctx.bench.observe(0.5, feedback="odometry")


@pytest.mark.parametrize(
    ("fault", "met"),
    [
        ("tracker:silent@1+1", False),
        ("servo.steer_FL:drop@1+1", False),
        ("tracker:silent@1+4", True),
        ("tracker:silent@3.6+0.1", True),
        ("servos:delayed@0+0.4,delay_s=0.01", True),
        ("imu:silent@0.01+0.2", True),
    ],
)
def test_a_fault_that_was_over_before_the_first_cycle_is_named(tmp_path, fault, met):
    """One that acted while its device was opened has been met by the opening."""
    result, reported = ran(
        tmp_path / "run", waits, BenchSource("emulated_floor", faults=read_faults((fault,)))
    )
    assert (result.exit_code, reported["faults_not_met"]) == (0, [] if met else [fault])
    said = [note for note in reported["notes"] if "before the first control cycle" in note]
    assert len(said) == (not met)
    if said:  # and by its time the user can plan another
        first_s = float(said[0].partition("cycle, at ")[2].split()[0])
        assert 3.0 < first_s < 3.6


@procedure(name="breaks", needs=("servos",), measurements=())
def breaks(ctx):
    """Ten centimetres up, and a mistake."""
    ctx.bench.drive(line((0, 0, 0), (0.1, 0, 0), duration_s=3.0))
    raise ZeroDivisionError("mine")


def test_a_run_that_failed_shows_where_it_drove(tmp_path):
    result, tree = ran(tmp_path / "run", breaks)
    assert result.verdict.value == "ERROR"
    assert {entry["title"] for entry in tree["figures"]} == {"Path", "Adhesion"}
    assert tree["teardown_errors"] == []
    assert all((tmp_path / "run" / entry["path"]).stat().st_size > 1000 for entry in tree["figures"])


STANDS = """
from hil.procedure import procedure

@procedure(name="stands", needs=("servos",), bench="emulated_floor", measurements=())
def run(ctx):
    \"\"\"Looks on for a moment.\"\"\"
    ctx.bench.observe(0.2, feedback="odometry")
"""


@pytest.mark.parametrize("more", [[], ["--json"]])
def test_a_pass_that_never_met_its_fault_ends_with_a_warning(tmp_path, capsys, more):
    (tmp_path / "stands.py").write_text(STANDS)
    words = ["run", str(tmp_path / "stands.py"), "--out", str(tmp_path / "out"), "--fault", "imu:off@1000"]
    assert main([*words, *more]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert "warning" in last
    assert "imu:off@1000" in last


@procedure(name="goes_on", needs=("servos",), measurements=(Measurement("seen", "1"),))
def goes_on(ctx):
    """Catches what a lost sensor raises, and measures all the same."""
    with suppress(DeviceTimeoutError):
        ctx.bench.observe(5.0)
    ctx.measure("seen", 1.0)


def test_a_procedure_that_goes_on_after_a_lost_sensor_passes_only_with_a_note(tmp_path):
    source = BenchSource("emulated_floor", seed=1, faults=read_faults(("imu:off@0.6",)))
    _, tree = ran(tmp_path / "run", goes_on, source)
    assert tree["verdict"] == "PASS"
    (note,) = tree["notes"]
    assert "imu" in note
    assert "nothing usable for 3." in note
    assert "nothing usable for 3." in write_run_page(tmp_path / "run").read_text()


def test_a_lost_sensor_that_ends_the_run_is_reported_once(tmp_path):
    source = BenchSource("emulated_floor", seed=1, faults=read_faults(("imu:off@0.6",)))
    _, tree = ran(tmp_path / "run", climb, source)
    assert (tree["verdict"], tree["notes"]) == ("ERROR", [])
    assert "imu" in tree["error"]["message"]


def send(*names):
    for name in names:
        os.kill(os.getpid(), getattr(signal, name))


def test_a_signal_while_the_bench_opens_waits_until_the_robot_is_held(tmp_path, monkeypatch):
    def opened(source, open_bench=BenchSource.open):
        bench = open_bench(source)
        bench.on_open(lambda: send("SIGTERM", "SIGHUP"))
        return bench

    monkeypatch.setattr(BenchSource, "open", opened)
    result, tree = ran(tmp_path / "run", climb)
    assert (tree["verdict"], tree["held"]["state"], result.exit_code) == ("ABORTED", "HELD", 4)
    assert "SIGTERM" in tree["error"]["message"]
    assert tree["measurements"][0]["outcome"] == "NOT MEASURED"


def test_further_signals_do_not_cut_short_what_the_first_one_began(tmp_path, monkeypatch):
    @procedure(name="struck", needs=("servos",), measurements=())
    def struck(ctx):
        """Is stopped at once, and again on the way out."""
        assert ctx.bench.on_wall
        try:
            send("SIGTERM")
        finally:
            send("SIGHUP", "SIGINT", "SIGINT")
            ctx.note("way out")

    def look(*given, before=HoldMonitor.look, **how):
        send("SIGINT", "SIGINT", "SIGHUP", "SIGTERM")
        return before(*given, **how)

    monkeypatch.setattr(HoldMonitor, "look", look)
    result, tree = ran(tmp_path / "run", struck)
    assert (tree["verdict"], tree["held"]["state"], result.exit_code) == ("ABORTED", "HELD", 4)
    assert "SIGTERM" in tree["error"]["message"]
    assert tree["notes"][-1] == "way out"


@pytest.mark.parametrize(
    "name", ["SIGTERM", *(pytest.param(name, marks=pytest.mark.long) for name in ("SIGHUP", "SIGINT"))]
)
def test_a_signal_after_the_verdict_takes_nothing_of_the_last_word(tmp_path, monkeypatch, capsys, name):
    """The report is still being written when it comes; before, in and after that are the same."""
    script = tmp_path / "nothing.py"
    script.write_text(
        "from hil.procedure import procedure\n\n\n"
        '@procedure(name="nothing", measurements=())\n'
        'def nothing(ctx):\n    """Opens its bench."""\n    assert ctx.bench.on_wall\n'
    )

    def slowly(folder, write=write_run_page):
        send(name, name)
        return write(folder)

    monkeypatch.setattr(run_page, "write_run_page", slowly)
    assert main(["run", str(script), "--out", str(tmp_path / "run"), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert (tree["verdict"], tree["held"]["state"]) == ("PASS", "HELD")
    assert (tmp_path / "run" / "report.html").exists()


def test_what_was_not_looked_at_has_not_moved_by_a_number(tmp_path):
    """A bench that does not open, and a procedure that opens none, know nothing of any way."""
    source = BenchSource("emulated", faults=read_faults(("servos:off@0",)))
    _, tree = ran(tmp_path / "run", climb, source)
    assert (tree["held"]["state"], tree["held"]["moved_m"]) == ("NOT HELD", None)
    assert held_in_words(tree["held"]).startswith("NOT HELD: not checked: the bench did not open")
    assert "not checked" in write_run_page(tmp_path / "run").read_text()


def test_where_no_device_was_opened_no_robot_needs_to_be_held(tmp_path, capsys):
    script = tmp_path / "wrong.py"
    script.write_text(
        "from hil.procedure import procedure\n\n\n"
        '@procedure(name="wrong", measurements=())\n'
        'def wrong(ctx):\n    """Asks for what there is not."""\n'
        '    ctx.reopen(overrides={"servos.colour": "red"})\n'
    )
    assert main(["run", str(script), "--out", str(tmp_path / "run"), "--json"]) == 2
    tree = json.loads(capsys.readouterr().out)
    assert (tree["held"]["state"], tree["held"]["moved_m"]) == ("not needed", None)
    assert "no device was opened" in tree["held"]["why"]
    assert "moved" not in held_in_words(tree["held"])
