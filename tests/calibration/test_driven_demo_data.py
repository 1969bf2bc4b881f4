"""`hil demo-data --plant`: recordings that an emulated bench drives, in the physics named."""

import json
import re

import numpy as np
import pytest

from hil.calibration.evaluation import position_rmse, track
from hil.cli import main
from hil.datasets.plain_csv import read_plain
from hil.robot.kinematics import WheelGeometry
from tests.selected import every

SHORT = ("--motions", "rotation_cw", "--repetitions", "1", "--seed", "2")


def _made(folder, *words):
    assert main(["demo-data", str(folder), *SHORT, *words]) == 0
    return read_plain(folder / "rotation_cw_1.csv"), json.loads((folder / "truth.json").read_text())


@pytest.mark.parametrize(("plant", "contact"), every(2, [("own", None), ("mujoco", "creep")]))
def test_a_bench_drives_the_recordings_and_its_robots_truth_lies_beside_them(tmp_path, plant, contact):
    if plant == "mujoco":
        pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    recording, truth = _made(tmp_path, "--plant", plant)
    assert (truth["plant"], truth["contact"]) == (plant, contact)
    turned = np.ptp(np.unwrap(recording.truth_pose[:, 2]))
    assert turned == pytest.approx(2 * np.pi, rel=0.06)
    known = WheelGeometry(*(np.array(truth[key]) for key in ("x_w_m", "y_w_m", "r_m", "delta0_rad")))
    nominal, true = (track(recording, g, "exact") for g in (WheelGeometry.nominal(), known))
    heading = [abs(run.error[-1, 2]) for run in (nominal, true)]
    assert heading[1] < 0.5 * heading[0]
    assert position_rmse(true) < 0.005


@pytest.mark.long
def test_faults_of_its_devices_are_in_the_recordings(tmp_path):
    gapped, _ = _made(tmp_path, "--plant", "own", "--fault", "mocap:off@10+1")
    gaps = np.sort(np.diff(gapped.truth_t_s))
    assert gaps[-1] > 0.9 > 0.2 > gaps[-2]


def test_a_device_that_stays_silent_ends_it_as_that_devices_error_and_leaves_nothing(tmp_path, capsys):
    words = ["demo-data", str(tmp_path / "made"), *SHORT, "--plant", "own", "--fault", "mocap:off@3+60"]
    assert main(words) == 3
    assert "no usable frame" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fault", "mocap:off@1+1"], "formulas have no devices"),
        (["--plant", "own", "--corrupt", "rotation_cw_1"], "not with --plant"),
        (["--plant", "own", "--contact", "creep"], "the own plant has one law"),
        (["--plant", "mujoco", "--contact", "viscous"], "expected creep or holding"),
        (["--contact", "holding"], "expected viscous or coulomb or elastic"),
        (["--motions", "rotation_wc"], "'rotation_wc' is unknown; .*did you mean rotation_cw"),
        (["--plant", "own", "--motions", "scan"], "'scan' is unknown"),
    ],
)
def test_what_does_not_go_together_is_named_and_leaves_nothing(tmp_path, capsys, words, message):
    assert main(["demo-data", str(tmp_path / "made"), *words]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "made").exists()
