"""Ground truth that leaps: what comes back is taken out and counted, what stays is named."""

import numpy as np
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import position_rmse, track
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import hidden_robot, make_set, simulate
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.dataset import build_recording
from hil.datasets.nominal_robot import Nominal
from hil.robot.kinematics import WheelGeometry

CAD = WheelGeometry.nominal()
DROPPED = "ground-truth rows that leap away and back dropped"


def wheels_of(one):
    return np.column_stack([one.wheel_angle_rad, one.steering_rad, one.wheel_rate_rad_s])


@pytest.fixture(scope="module")
def clean():
    return simulate(hidden_robot(4), "line_x", "line_x_1", np.random.default_rng(5))


def line(change, robot=None):
    """A line whose ground truth (m, 3) `change` alters in place."""
    robot = robot or hidden_robot(4)
    clean = simulate(robot, "line_x", "line_x_1", np.random.default_rng(5))
    pose = clean.truth_pose.copy()
    change(pose)
    spoilt = build_recording(
        "line_x_1",
        Log(clean.t_s, wheels_of(clean)),
        Log(clean.truth_t_s, pose),
        motion="line_x",
        nominal=robot.nominal,
    )
    return clean, spoilt


def shift(rows, by_m):
    def change(pose):
        pose[rows, :2] += by_m

    return change


@pytest.mark.parametrize(
    ("rows", "by_m", "dropped"),
    [
        ([700], 5.0, 1),
        ([-1], 0.5, 1),
        ([0], 0.5, 1),
        ([300, 301, 302], 0.05, 3),
        ([300, 301, 900], 1e4, 3),
        (slice(-30, None), 0.1, 30),
    ],
)
def test_rows_that_leap_away_are_taken_out_and_counted(rows, by_m, dropped):
    clean, spoilt = line(shift(rows, by_m))
    assert spoilt.repairs[DROPPED] == dropped
    assert len(spoilt.truth_pose) == len(clean.truth_pose) - dropped
    rmse_m = [position_rmse(track(one, CAD)) for one in (clean, spoilt)]
    assert rmse_m[1] == pytest.approx(rmse_m[0], rel=0.05)


def test_a_marker_taken_for_another_turns_the_robot_for_some_rows():
    def turn(pose):
        pose[400:410, 2] += np.pi

    clean, spoilt = line(turn)
    assert spoilt.repairs[DROPPED] == 10
    assert np.ptp(spoilt.truth_pose[:, 2]) == pytest.approx(np.ptp(clean.truth_pose[:, 2]), abs=1e-3)


def test_one_row_in_a_hundred_is_no_reason_to_blame_the_geometry():
    rng = np.random.default_rng(1)
    data = []
    for one in make_set(hidden_robot(4), 4, repetitions=1):
        pose, wheels = one.truth_pose.copy(), np.column_stack([one.wheel_angle_rad, one.steering_rad])
        bad = rng.random(len(pose)) < 0.01
        pose[bad, :2] += rng.normal(0.0, 0.3, (int(bad.sum()), 2))
        data.append(build_recording(one.name, Log(one.t_s, wheels), Log(one.truth_t_s, pose)))
    setting, whole = make_setting("recommended", model="exact"), make_set(hidden_robot(4), 4, repetitions=1)
    found, clean = (calibrate(each, setting, MonotonicClock(), validate=False) for each in (data, whole))
    assert found.rejected == clean.rejected
    np.testing.assert_allclose(found.fit.solution.z, clean.fit.solution.z, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("by_m", [0.05, 5.0])
def test_a_leap_that_lasts_stays_and_is_named_with_its_time(by_m):
    clean, spoilt = line(shift(slice(1100, None), by_m))
    assert len(spoilt.truth_pose) == len(clean.truth_pose)
    (reported,) = spoilt.warnings()
    assert reported.startswith(
        "line_x_1: 1 ground-truth leaps that last left as they are (first 11.0 s after"
    )
    assert "leave the recording out" in reported


def test_the_time_of_a_leap_is_reported_from_the_begin_of_the_ground_truth(clean):
    pose = clean.truth_pose.copy()
    pose[1100:, :2] += 0.5
    spoilt = build_recording(
        "line_x_1", Log(clean.t_s + 1e4, wheels_of(clean)), Log(clean.truth_t_s + 1e4, pose)
    )
    assert "(first 11.0 s after its begin, by 0.7" in spoilt.warnings()[0]


def test_a_robot_that_drives_on_unseen_for_a_while_has_not_leapt(clean):
    """Its markers are hidden for three seconds, in which it goes further than any noise."""
    seen = (clean.truth_t_s < 8.0) | (clean.truth_t_s > 11.0)
    assert np.linalg.norm(np.diff(clean.truth_pose[seen, :2], axis=0), axis=1).max() > 0.1
    found = build_recording(
        "line_x_1", Log(clean.t_s, wheels_of(clean)), Log(clean.truth_t_s[seen], clean.truth_pose[seen])
    )
    assert not any("leap" in what for what in found.repairs)


def test_ground_truth_that_leaps_all_the_time_is_refused():
    rng = np.random.default_rng(2)

    def scatter(pose):
        pose[:, :2] += np.repeat(rng.uniform(0.0, 5.0, (1 + len(pose) // 30, 2)), 30, axis=0)[: len(pose)]

    with pytest.raises(DataError, match=r"\d+ of \d+ rows are out of reach"):
        line(scatter)


@pytest.mark.parametrize("scale", [0.2, 1.0, 10.0])
def test_a_robot_of_any_size_and_noise_of_millimetres_are_no_leaps(scale):
    rng = np.random.default_rng(3)
    robot = Nominal(WheelGeometry(scale * CAD.x_m, scale * CAD.y_m, scale * CAD.radius_m))

    def shake(pose):
        pose += rng.normal(0.0, 1.0, pose.shape) * (0.003, 0.003, 0.005)

    assert line(shake, hidden_robot(4, nominal=robot))[1].repairs == {}
