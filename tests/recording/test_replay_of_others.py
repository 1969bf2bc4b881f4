"""`hil replay` of recordings of other origin: what it says of them, and what it refuses."""

import csv
import json
import math

import numpy as np
import pytest

from hil.cli import main
from hil.config.estimator import EstimatorConfig

RADIUS_M, LEVER_M = 0.0254, 0.1125 * math.sqrt(2.0)
STEERED_RAD, ROLLS = np.radians([-45.0, 45.0, -45.0, 45.0]), np.array([-1.0, -1.0, 1.0, 1.0])
HEAD = ["t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)), "x", "y", "theta"]


def written(path, *, scale=1.0, turning=False, seconds=6.0):
    """Wheels and truth of a line or a turn that starts and stops at once; `scale`: how far it really went."""
    rng = np.random.default_rng(3)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(HEAD)
        for k in range(int(40 * seconds)):
            t = k / 40
            way = 0.1 * min(max(0.0, t - 1.0), seconds - 2.0)
            turned = (way / RADIUS_M * (ROLLS if turning else 1.0) + 1e-3 * rng.normal(size=4)).tolist()
            true = [0.0, 0.0, way / LEVER_M] if turning else [scale * way, 0.0, 0.0]
            table.writerow([t, *turned, *(STEERED_RAD if turning else (0, 0, 0, 0)), *true])
    return path


@pytest.fixture
def recording(tmp_path):
    return written(tmp_path / "line_x_1.csv")


def test_a_folder_is_refused_with_what_lies_in_it(recording, tmp_path, capsys):
    """It had replayed the first file and said nothing of the others."""
    written(tmp_path / "line_x_2.csv")
    assert main(["replay", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert f"is a folder of 2 recordings (line_x_1.csv, line_x_2.csv); name one, as {recording}" in said.err
    assert said.out == ""


def test_a_foreign_recording_is_nothing_to_verify(recording, capsys):
    """It had been asked to differ in its first cycle."""
    assert main(["replay", str(recording), "--verify"]) == 2
    assert "not a recording of this bench: there is nothing to verify" in capsys.readouterr().err


def replayed(capsys, *words, code=0):
    assert main(["replay", *map(str, words), "--json"]) == code
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def test_a_sensor_that_is_not_there_has_no_figures(recording, tmp_path, capsys):
    """Gyro and camera had a NIS of 1, the ideal, in recordings of wheels and motion capture."""
    page = tmp_path / "page.html"
    result, _ = replayed(capsys, recording, "--page", page)
    for name in ("ekf", "ukf"):
        figures = result["estimators"][name]
        assert figures["nis_wheels"] > 0.0
        for key in (
            "nis_gyro",
            "nis_tracker",
            "nis_gravity",
            "lag1_gyro",
            "rejected_gyro",
            "rejected_tracker",
        ):
            assert figures[key] is None, key
    assert result["sensors"] == ["wheels", "mocap"]
    assert "NIS gyro" not in page.read_text(encoding="utf-8")


def test_wheels_alone_say_where_the_robot_turns(tmp_path, capsys):
    """Gates had refused the start of every turn, which nothing else measures: degrees were lost."""
    path = written(tmp_path / "rotation_ccw_1.csv", turning=True)
    result, _ = replayed(capsys, path)
    reported = result["estimators"]
    for name in ("ekf", "ukf", "smoother"):
        assert reported[name]["rmse_theta_rad"] < 1.2 * reported["odometry"]["rmse_theta_rad"] + math.radians(
            0.02
        )
        assert reported[name]["nees_pose"] < 6.0
    assert reported["ekf"]["rejected_wheels"] == 0.0


def test_process_noise_that_a_user_has_chosen_is_kept():
    chosen = EstimatorConfig(process={"angular_acceleration_rad_s2_sqrt_hz": 0.3}).on_wheels_alone().process
    assert chosen.angular_acceleration_rad_s2_sqrt_hz == 0.3
    assert chosen.acceleration_m_s2_sqrt_hz == 1.0


def test_another_robots_recording_is_doubted_as_evaluate_does(tmp_path, capsys):
    path, page = written(tmp_path / "line_x_1.csv", scale=2.0), tmp_path / "page.html"
    result, said = replayed(capsys, path, "--page", page, code=2)
    assumed, warning = result["warnings"]
    assert "bench emulated_floor are assumed" in assumed
    named, _ = replayed(capsys, path, "--bench", "emulated", code=2)
    assert not any("does not say" in line for line in named["warnings"])
    assert "the robot went 2.00 times as far as its wheels say" in warning
    assert "--bench" in warning
    assert f"warning: {warning}" in said
    assert "2.00 times as far" in page.read_text(encoding="utf-8")
