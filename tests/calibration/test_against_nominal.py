"""A calibration is compared with doing nothing, on recordings that the fit has not seen."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.against_nominal import against_nominal
from hil.calibration.calibrate import calibrate
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import HiddenRobot, hidden_robot, make_set
from hil.cli import main
from hil.core.clock import MonotonicClock
from hil.datasets.plain_csv import write_plain
from hil.robot.kinematics import WheelGeometry

EXACT = make_setting("recommended", model="exact")
LINES = ("line_x", "line_y", "rotation_ccw")


def row(position_m, heading_rad=0.0):
    return {"rmse_position_m": position_m, "rmse_theta_rad": heading_rad}


def table(**rows):
    keys = ("rmse_position_m", "rmse_theta_rad")
    return {**rows, "mean": {k: float(np.mean([r[k] for r in rows.values()])) for k in keys}}


NOTHING = table(a=row(0.010), b=row(0.020))


@pytest.mark.parametrize(
    ("repetitions", "motions", "worse", "by_m", "shown"),
    [
        (table(a=row(0.004), b=row(0.006)), table(a=row(0.03), b=row(0.03)), False, 0.010, True),
        (table(a=row(0.004), b=row(0.006)), table(a=row(0.003), b=row(0.003)), False, 0.010, False),
        (table(a=row(0.014), b=row(0.026)), table(a=row(0.001), b=row(0.001)), True, -0.005, False),
        (table(a=row(0.010), b=row(0.0201)), {}, False, -5e-5, False),
        (table(b=row(0.010)), {}, False, 0.010, False),
        ({}, table(a=row(0.014), b=row(0.026)), True, -0.005, False),
        (table(a=row(0.012), b=row(0.022)), {}, True, -0.002, False),
        (table(a=row(0.010, 0.2), b=row(0.020, 0.2)), {}, True, 0.015 - np.hypot(0.015, 0.2 * 0.16), False),
    ],
)
def test_the_first_table_that_the_fit_has_not_seen_decides(repetitions, motions, worse, by_m, shown):
    tables = {
        "in_sample": table(a=row(0.001), b=row(0.001)),
        "leave_one_repetition_out": repetitions,
        "leave_one_motion_out": motions,
    }
    found = against_nominal({k: v for k, v in tables.items() if v}, NOTHING, 0.16)
    assert found.worse == worse
    assert found.by_m == pytest.approx(by_m)
    assert (found.on_motions is not None) == shown
    assert found.to_json()["worse"] == worse


def test_a_robot_as_on_paper_passes_and_so_does_a_hidden_one():
    on_paper = HiddenRobot(WheelGeometry.nominal(), np.ones(4))
    for robot in (on_paper, hidden_robot(3)):
        found = calibrate(make_set(robot, 5, LINES, 2, slip_share=0.0), EXACT, MonotonicClock())
        assert found.to_json()["verdict"] == "PASS"
        assert found.compared.on == "leave_one_repetition_out"
    assert found.compared.by_m > 0.005


@pytest.fixture(scope="module")
def unlike(tmp_path_factory):
    """Two repetitions of each motion, whose ways are 3 % too long and as much too short."""
    folder = tmp_path_factory.mktemp("unlike")
    robot = HiddenRobot(WheelGeometry.nominal(), np.ones(4))
    for k, one in enumerate(make_set(robot, 5, LINES, 2, run_to_run=0.0, slip_share=0.0)):
        pose = one.truth_pose * (1.03 if k % 2 else 0.97)
        write_plain(folder / f"{one.name}.csv", replace(one, truth_pose=pose))
    return folder


def test_a_result_worse_than_nominal_fails_and_is_not_written(unlike, tmp_path, capsys):
    out = tmp_path / "calibration.toml"
    arguments = ["calibrate", str(unlike), "--out", str(out), "--model", "exact", "--json"]
    assert main(arguments) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "FAIL"
    assert result["compared_with_nominal"]["worse"]
    assert not out.exists()
    assert main([*arguments, "--accept-worse"]) == 0
    assert out.exists()


def test_a_better_heading_does_not_hide_a_worse_position():
    nominal = table(a=row(0.0005, 0.05))
    found = against_nominal({"in_sample": table(a=row(0.004, 0.01))}, nominal, 0.16)
    assert found.by_m > 0.0
    assert found.worse
