"""What motion capture did not see is no measurement: runs fail, say why, and warn of nothing else."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from procedure_runs import options_of

from hil.bench import open_bench
from hil.core.errors import DataError
from hil.core.geometry import wrap_array
from hil.faults.files import read_faults
from hil.loop.driven_motion import Motion
from hil.procedure import procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.measurements import Measurement, Verdict
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import run_procedure
from hil.procedure.sample_arrays import Series
from hil.procedure.tracking_errors import tracking_errors, unseen
from hil.procedures import grid_scan
from hil.procedures.surface_identification.slip import held, slip_of
from hil.procedures.tracker_extrinsics import disagreement_m
from hil.procedures.tracker_extrinsics.hand_eye import Truth
from hil.replay.truth_errors import errors
from hil.robot.trajectories import line
from tests.patience import FANLESS

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SHORT = {
    "cases": ["x_line"],
    "feedbacks": ["odometry", "ekf"],
    "optimal": False,
    "length_m": 0.1,
    "duration_s": 3.0,
    "hold_s": 1.5,
}
GAPS = "mocap:intermittent@1,period_s=2,duty=0.97"


def run(proc, folder, fault, **parameters):
    source = BenchSource("emulated", faults=read_faults((fault,)), overrides=FANLESS)
    return run_procedure(proc, source, options_of(folder, parameters))


def outcomes(result):
    return {row["name"]: row["outcome"] for row in result.to_json()["measurements"]}


@procedure(name="climb", needs=("servos", "mocap"), measurements=(Measurement("end", "mm", high=50.0),))
def climb(ctx):
    """As in the tutorial."""
    motion = ctx.bench.drive(line((0, 0, 0), (0.1, 0, 0), duration_s=3.0), feedback="odometry")
    ctx.measure("end", 1e3 * abs(motion.mocap[-1, 0] - 0.1))


@pytest.mark.parametrize("fault", ["mocap:off@5", pytest.param(GAPS, marks=pytest.mark.long)])
def test_an_end_that_was_not_seen_fails_a_script_that_measures_it(tmp_path, fault):
    result = run(climb, tmp_path / "run", fault)
    assert result.error is None
    assert (result.verdict, result.exit_code) == (Verdict.FAIL, 1)
    assert result.to_json()["said"] == "Its one limit failed: end is no finite number, at most 50 mm."


def test_a_line_whose_end_was_not_seen_fails_by_its_end_alone(tmp_path):
    result = run(load_procedure("wall_tracking"), tmp_path / "run", "mocap:off@4.4", **SHORT)
    found = outcomes(result)
    assert result.verdict is Verdict.FAIL
    assert found["x_line.ekf.end"] == found["x_line.odometry.shortfall"] == "FAIL"
    assert found["x_line.ekf.rmse_x_worst"] == found["x_line.ekf.rmse_heading"] == "PASS"
    notes = [n for n in result.facts["notes"] if "motion capture" in n]
    assert [n.partition(":")[0] for n in notes] == ["x_line odometry seed 0", "x_line ekf seed 0"]
    assert all("did not see its last 0.3 s" in n and "RMSE" not in n for n in notes)
    assert result.facts["headline"] == ""


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "parameters", "measured"),
    [
        ("wall_tracking", SHORT, "x_line.ekf.rmse_x_worst"),
        ("grid_scan", {"lanes": 2, "lane_length_m": 0.2, "hold_s": 0.5}, "covered"),
    ],
)
def test_a_motion_seen_in_flashes_is_not_measured(tmp_path, name, parameters, measured):
    result = run(load_procedure(name), tmp_path / "run", GAPS, **parameters)
    assert result.error is None
    assert outcomes(result)[measured] == "FAIL"
    assert any("% of the motion (RMSE needs 90 %)" in note for note in result.facts["notes"])


@pytest.fixture(scope="module")
def driven():
    with open_bench("emulated", seed=2, overrides=FANLESS) as bench:
        start = bench.settle(0.3)
        goal = np.add(start, [0.1, 0.0, 0.0])
        return bench.drive(line(start, goal, duration_s=3.0), hold_s=1.0, start_pose=start)


def blind(motion, begin, end):
    """The motion without truth from one row to another (n counted from the end where negative)."""
    truth = motion.mocap
    truth[begin:end] = np.nan
    return SimpleNamespace(
        mocap=truth,
        truth=(truth, ""),
        reference=motion.reference,
        records=motion.records,
        t_s=motion.t_s,
        wheels=motion.wheels,
        estimate=motion.estimate,
    )


def test_errors_are_truth_minus_reference(driven):
    errors, apart = tracking_errors(driven), driven.mocap - driven.reference
    last = apart[driven.t_s > driven.t_s[-1] - 0.3].mean(axis=0)
    assert errors["end_x"] == pytest.approx(1e3 * last[0])
    assert errors["end_heading"] == pytest.approx(np.degrees(wrap_array(last)[2]))
    assert errors["saturated_s"] == 0.0


def test_what_was_seen_is_measured_and_the_rest_is_not(driven):
    whole = tracking_errors(driven)
    assert unseen(whole) == ""
    assert whole["seen"] == pytest.approx(1.0, abs=0.02)
    end = tracking_errors(blind(driven, -40, None))
    assert {k for k, v in end.items() if v != v} == {"end_x", "end_y", "end_heading"}
    assert (end["rmse_x"], end["steering_travel"]) == (whole["rmse_x"], whole["steering_travel"])
    middle = tracking_errors(blind(driven, 20, 60))
    assert {k for k, v in middle.items() if v != v} == {"rmse_x", "rmse_y", "rmse_heading", "worst"}
    assert middle["end_x"] == whole["end_x"]
    assert "saw" in unseen(middle)
    nothing = tracking_errors(blind(driven, 0, None))
    assert nothing["seen"] == 0.0
    assert "saw 0 % of the motion" in unseen(nothing)


def test_slip_and_hold_are_not_reported_by_half_a_motion(driven):
    assert isinstance(held(driven), bool)
    for motion in (blind(driven, -40, None), blind(driven, 10, 110), blind(driven, 0, None)):
        with pytest.raises(DataError, match="expected at least 80 %, and its end"):
            held(motion)
        with pytest.raises(DataError, match="expected at least 80 %, and its end"):
            slip_of(motion, driven.estimate)


def test_a_replay_has_no_error_at_an_end_that_was_not_seen(driven):
    assert math.isfinite(errors(driven)["final_position_m"])
    unseen_end = tuple(
        replace(r, measurements=replace(r.measurements, mocap=())) for r in driven.records[-40:]
    )
    found = errors(Motion((*driven.records[:-40], *unseen_end)))
    assert math.isnan(found["final_position_m"])
    assert math.isfinite(found["rmse_position_m"])


def test_a_scan_does_not_cover_what_was_not_seen():
    p = grid_scan.Parameters(lanes=1, lane_length_m=1.0)
    path = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros(101)])
    assert grid_scan.covered_cells(path, np.zeros(3), p).mean() == 1.0
    path[40:60] = np.nan
    assert grid_scan.covered_cells(path, np.zeros(3), p).mean() == pytest.approx(0.79, abs=0.01)
    assert grid_scan.covered_cells(np.full((5, 2), np.nan), np.zeros(3), p).mean() == 0.0


def seen_at(t_s):
    """Poses on a line of 0.1 m/s."""
    way = np.column_stack([0.1 * t_s, np.zeros_like(t_s), np.zeros_like(t_s)])
    return Series(t_s, t_s, np.full(len(t_s), np.nan), way, len(t_s))


def test_a_camera_is_not_held_against_motion_capture_that_saw_nothing():
    whole = np.arange(0.0, 4.0, 0.01)
    truth = seen_at(whole[(whole < 1.0) | ((whole > 1.2) & (whole < 3.0))])
    asked = np.array([0.5, 1.1, 2.9, 3.1, 3.2, 3.9])
    np.testing.assert_array_equal(Truth(truth).sees(asked), [True, True, True, True, False, False])
    leg = SimpleNamespace(truth=truth, aligned=seen_at(whole))
    assert disagreement_m([leg]) < 0.01
    late = SimpleNamespace(truth=seen_at(whole[whole > 2.0]), aligned=seen_at(whole))
    assert math.isnan(disagreement_m([late]))
