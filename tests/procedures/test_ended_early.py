"""A procedure of several drives that is ended early keeps what the finished ones were measured to be."""

import signal

import pytest

from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.runner import RunOptions, run_procedure
from hil.procedure.scripts import load_procedure
from hil.vocabulary.clock import MonotonicClock

SHORT = {"processes": 1, "length_m": 0.05, "duration_s": 2.0, "hold_s": 0.5}
CASES = {
    "wall_tracking": (SHORT | {"cases": ["x_line"], "feedbacks": ["odometry", "ekf"]}, "x_line.odometry."),
    "wall_ablation": (SHORT | {"cases": ["x_line", "y_line"]}, "x_line."),
}


@pytest.mark.parametrize("name", CASES)
def test_what_was_finished_is_measured(name, tmp_path):
    parameters, measured = CASES[name]
    interrupts = Interrupts()

    def report(what, done, total):
        if (what.startswith("seed") or what == "lines") and done == 1:
            interrupts.handle(signal.SIGTERM)

    options = RunOptions(
        tmp_path / "out", MonotonicClock(), "2026-01-01", parameters, report=report, interrupts=interrupts
    )
    result = run_procedure(load_procedure(name), BenchSource("emulated"), options)
    told = result.to_json()
    assert (told["verdict"], told["exit_code"]) == ("ABORTED", 4)
    known = [row for row in told["measurements"] if row["value"] is not None]
    assert known
    assert [row["name"] for row in known if not row["name"].startswith(measured)] == []
    assert {row["outcome"] for row in told["measurements"] if row["value"] is None} == {"NOT MEASURED"}
    assert len(told["tables"][0]["rows"]) == 1
    assert not told["teardown_errors"], told["error"]
