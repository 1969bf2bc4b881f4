"""Gaps in ground truth, a begin in motion, ground truth that is slow: odometry errs as it does without."""

import numpy as np
import perfect_robot as perfect
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import position_rmse, track
from hil.calibration.problem import make_setting
from hil.calibration.warnings import warnings_of
from hil.core.clock import MonotonicClock
from hil.datasets.plain_csv import read_plain
from hil.robot.kinematics import WheelGeometry
from tests.selected import every

WHEELS = WheelGeometry.nominal()


def with_gaps(found):
    """The body is lost for 4 s and for 1.5 s, both in curves."""
    lost = ((found.truth_s > 5.0) & (found.truth_s < 9.0)) | ((found.truth_s > 12.0) & (found.truth_s < 13.5))
    return found.truth_where(~lost)


def rolling(found):
    """Both logs begin while the robot drives."""
    return found.truth_where(found.truth_s > 4.0).wheels_where(found.t_s > 4.1)


CASES = {
    "gaps": (with_gaps, {}),
    "rolling": (rolling, {}),
    "at 2 Hz": (lambda found: found, {"truth_hz": 2.0}),
    "at 2 Hz, rolling, gaps": (lambda found: with_gaps(rolling(found)), {"truth_hz": 2.0}),
}


def read(tmp_path, name, found):
    return read_plain(perfect.write_csv(tmp_path / f"{name}.csv", found))


@pytest.mark.parametrize("case", CASES)
def test_odometry_of_a_perfect_robot_errs_by_the_noise_of_its_truth(tmp_path, case):
    cut, options = CASES[case]
    found = track(read(tmp_path, "curve_1", cut(perfect.drive(**options))), WHEELS)
    assert position_rmse(found) == pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.3)
    assert np.max(np.abs(found.error)) < 1.2e-3


@pytest.mark.parametrize(
    ("case", "model"), every(7, [(case, model) for case in CASES for model in ("exact", "dry-friction")])
)
def test_a_fit_finds_the_wheels_all_the_same(tmp_path, case, model):
    """Radii are 1.2 % too large and steering zeros 10 mrad off; what data show are their means."""
    cut, options = CASES[case]
    found = [
        cut(perfect.drive(seed=k, sense=(-1.0) ** k, radius_m=0.0257, zero=0.01, **options)) for k in range(2)
    ]
    recordings = [read(tmp_path, f"curve{k}_1", one) for k, one in enumerate(found)]
    setting = make_setting("recommended", model=model)
    result = calibrate(recordings, setting, MonotonicClock(), validate=False)
    if model == "exact":
        assert np.mean(result.geometry.radius_m) == pytest.approx(0.0257, rel=1.5e-3)
        assert np.mean(result.geometry.steering_zero_rad) == pytest.approx(0.01, abs=1.5e-3)
    left = [position_rmse(track(one, result.geometry, model)) for one in recordings]
    assert max(left) < 3e-3


def test_only_a_start_in_motion_is_reported(tmp_path):
    still, moving = (
        read(tmp_path, f"{name}_1", cut(perfect.drive(truth_hz=10.0)))
        for name, cut in (("still", lambda found: found), ("moving", rolling))
    )
    (line,) = warnings_of([still, moving])
    assert line.startswith("moving_1: the wheels roll when it begins")


def test_a_table_of_rates_alone_is_integrated(tmp_path):
    whole = perfect.write_csv(tmp_path / "whole_1.csv", perfect.drive())
    lines = [line.split(",") for line in whole.read_text().splitlines()]
    (tmp_path / "rates_1.csv").write_text("\n".join(",".join([row[0], *row[5:]]) for row in lines))
    found = read_plain(tmp_path / "rates_1.csv")
    assert position_rmse(track(found, WHEELS)) == pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.3)
    assert "integrated from their rates" in " ".join(found.repairs)
