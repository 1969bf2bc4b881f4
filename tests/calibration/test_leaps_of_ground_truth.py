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
from hil.datasets.nominal_robot import Nominal
from hil.datasets.start_pose import start_of
from hil.datasets.wheel_log import build_recording
from hil.datasets.wrong_signs import contradictions
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


@pytest.mark.parametrize("by_m", [0.012, 0.05, 5.0])
def test_a_leap_that_lasts_contradicts_the_recording_and_has_its_time(by_m):
    clean, spoilt = line(shift(slice(1100, None), by_m))
    assert len(spoilt.truth_pose) == len(clean.truth_pose)
    (named,) = spoilt.contradictions
    assert "11.0 s after its begin" in named
    (refused,) = contradictions([clean, spoilt], CAD)
    assert named in refused


def test_the_time_of_a_leap_is_reported_from_the_begin_of_the_ground_truth(clean):
    pose = clean.truth_pose.copy()
    pose[1100:, :2] += 0.5
    spoilt = build_recording(
        "line_x_1", Log(clean.t_s + 1e4, wheels_of(clean)), Log(clean.truth_t_s + 1e4, pose)
    )
    assert "by 0.71 m 11.0 s after its begin" in spoilt.contradictions[0]


TURNS = [0.03, 0.05, 0.12, -0.18, np.pi]


def stepped(one, turn_rad, at=0.5, over=1, noise_rad=0.0):
    """A recording whose heading steps at a part of its ground truth, spread over some rows, and stays."""
    pose, first = one.truth_pose.copy(), round(at * len(one.truth_pose))
    pose[:, 2] += turn_rad * np.clip((np.arange(len(pose)) - first + 1) / over, 0.0, 1.0)
    pose[:, 2] += np.random.default_rng(1).normal(0.0, noise_rad, len(pose))
    return build_recording(
        one.name, Log(one.t_s, wheels_of(one)), Log(one.truth_t_s, pose), motion=one.motion
    )


@pytest.fixture(scope="module")
def motions():
    return make_set(hidden_robot(4), 4, repetitions=2, slip_share=0.5)


@pytest.mark.parametrize("turn_rad", TURNS)
def test_a_heading_that_steps_and_stays_is_found_in_every_motion(motions, turn_rad):
    for one in motions[::2]:
        assert one.contradictions == ()
        for at in (0.3, 0.7):
            assert len(stepped(one, turn_rad, at).contradictions) == 1


def test_a_filter_or_noise_does_not_hide_a_step_of_the_heading(clean):
    assert stepped(clean, 0.0, noise_rad=0.004).contradictions == ()
    for hidden in ({"over": 6}, {"noise_rad": 0.004}):
        assert len(stepped(clean, 0.06, **hidden).contradictions) == 1


@pytest.mark.parametrize("late_s", [-0.15, 0.15])
def test_a_late_clock_is_no_step_of_the_heading(motions, late_s):
    for one in motions[::2]:
        moved = build_recording(
            one.name, Log(one.t_s, wheels_of(one)), Log(one.truth_t_s + late_s, one.truth_pose)
        )
        assert moved.contradictions == ()


@pytest.mark.parametrize("rows", [slice(0, 60), slice(20, 90), slice(-70, None)])
def test_a_step_in_a_rest_costs_these_rows_and_nothing_else(clean, rows):
    pose = clean.truth_pose.copy()
    pose[rows, 2] += 0.15
    spoilt = build_recording("line_x_1", Log(clean.t_s, wheels_of(clean)), Log(clean.truth_t_s, pose))
    assert spoilt.contradictions == ()
    assert start_of(spoilt).pose == pytest.approx(start_of(clean).pose, abs=1e-4)
    assert len(pose) - len(spoilt.truth_pose) == len(pose[rows])


def test_steps_are_left_out_where_few_have_one_and_refused_where_all_have(motions):
    setting = make_setting("recommended", model="exact")
    few = [stepped(one, 0.12) if k in (1, 6, 7) else one for k, one in enumerate(motions)]
    found = calibrate(few, setting, MonotonicClock(), validate=False)
    assert set(found.rejected) == {motions[k].name for k in (1, 6, 7)}
    rest = [one for k, one in enumerate(motions) if k not in (1, 6, 7)]
    whole = calibrate(rest, setting, MonotonicClock(), validate=False)
    np.testing.assert_array_equal(found.fit.solution.z, whole.fit.solution.z)
    with pytest.raises(DataError, match=r"steps by 0.12 rad .* 12 of 12"):
        calibrate([stepped(one, 0.12) for one in motions], setting, MonotonicClock(), validate=False)


def test_a_robot_that_drives_on_unseen_for_a_while_has_not_leapt(clean):
    """Its markers are hidden for three seconds, in which it goes further than any noise."""
    seen = (clean.truth_t_s < 8.0) | (clean.truth_t_s > 11.0)
    assert np.linalg.norm(np.diff(clean.truth_pose[seen, :2], axis=0), axis=1).max() > 0.1
    found = build_recording(
        "line_x_1", Log(clean.t_s, wheels_of(clean)), Log(clean.truth_t_s[seen], clean.truth_pose[seen])
    )
    assert not any("leap" in what for what in found.repairs)
    assert found.contradictions == ()


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

    shaken = line(shake, hidden_robot(4, nominal=robot))[1]
    assert (shaken.repairs, shaken.contradictions) == ({}, ())
