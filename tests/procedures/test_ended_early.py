"""A procedure of several drives that is ended early keeps what the finished ones were measured to be."""

import signal

import pytest
from procedure_runs import options_of

from hil.core.interfaces import Sink
from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import run_procedure
from tests.patience import FANLESS

SHORT = {"processes": 1, "length_m": 0.05, "duration_s": 2.0, "hold_s": 0.5}
CASES = {
    "wall_tracking": (SHORT | {"cases": ["x_line"], "feedbacks": ["odometry", "ekf"]}, "x_line.odometry."),
    "surface_identification": ({"length_m": 0.11, "hold": False, "processes": 1}, ""),
    "wall_ablation": (SHORT | {"cases": ["x_line", "y_line"]}, "x_line."),
}


LASTING = pytest.param("surface_identification", marks=pytest.mark.long)


@pytest.mark.parametrize("name", ["wall_tracking", "wall_ablation", LASTING])
def test_what_was_finished_is_measured(name, tmp_path):
    parameters, measured = CASES[name]
    interrupts = Interrupts()

    def report(what, done, total):
        if (what.startswith("seed") or what in ("lines", "repetition 3")) and done == 1:
            interrupts.handle(signal.SIGTERM)

    options = options_of(tmp_path / "out", parameters, report=report, interrupts=interrupts)
    result = run_procedure(load_procedure(name), BenchSource("emulated", overrides=FANLESS), options)
    reported = result.to_json()
    assert (reported["verdict"], reported["exit_code"]) == ("ABORTED", 4)
    known = [row for row in reported["measurements"] if row["value"] is not None]
    assert known
    assert [row["name"] for row in known if not row["name"].startswith(measured)] == []
    assert {row["outcome"] for row in reported["measurements"] if row["value"] is None} <= {"NOT MEASURED"}
    assert reported["tables"][0]["rows"]
    assert not reported["teardown_errors"], reported["error"]


class EndsTheSecondBench(Sink):
    """Asks for the end once a bench whose clock began anew has run for a while."""

    def __init__(self, interrupts):
        self.interrupts, self.last_ns, self.benches = interrupts, 0, 1

    def write(self, record):
        self.benches += record.start_ns < self.last_ns
        self.last_ns = record.start_ns
        if self.benches == 2:
            self.interrupts.handle(signal.SIGTERM)

    def close(self):
        pass


@pytest.mark.long
def test_levels_of_force_are_measured_where_the_slide_is_cut_off(tmp_path):
    interrupts = Interrupts()
    options = options_of(tmp_path / "out", {"levels": 4, "dwell_s": 0.8}, interrupts=interrupts)
    source = BenchSource("emulated", watch=(EndsTheSecondBench(interrupts),))
    reported = run_procedure(load_procedure("adhesion_check"), source, options).to_json()
    assert reported["verdict"] == "ABORTED"
    known = {row["name"] for row in reported["measurements"] if row["value"] is not None}
    assert {"cells_zero_1", "cells_zero_2", "rated_force"} <= known
    assert not {"slides_at", "friction"} & known
    assert not reported["teardown_errors"], reported["error"]
