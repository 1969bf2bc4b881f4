"""Small steps of the body show what wheels, camera and motion capture of the bench file have wrong."""

import numpy as np
import pytest
from procedure_runs import run

from hil.config.loading import load_bench
from hil.procedures.bring_up.body_steps import camera_checks, step_checks

STEP_M, TURN_RAD, CREEP = 0.04, 0.105, 0.96
UNKNOWN = np.full(4, np.nan)
KNOWN = np.zeros(4)
CONFIG = load_bench("emulated")


def ways(**changed):
    """Steps up the wall, across and a turn as a right bench sees them; the climb creeps."""
    true = np.diag([CREEP * STEP_M, STEP_M, TURN_RAD])
    true[:2, 2] = -0.0024
    wheels = np.diag([STEP_M, STEP_M, 1.02 * TURN_RAD])
    return {"odometry": wheels, "mocap": true, "tracker": true.copy(), **changed}


def states(found):
    return {key: state for check in found for key, state in [(check.key, check.state)]}


def contradicted(found):
    return {check.key for check in found if check.state == "contradicted"}


def turned(rows, angle_rad):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return rows @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("steered", [UNKNOWN, KNOWN])
def test_a_right_bench_is_confirmed_within_bounds(steered):
    found = list(step_checks(CONFIG, ways(), steered))
    assert set(states(found).values()) == {"confirmed"}
    assert set(states(found)) >= {"robot.wheel_radius_m", "robot.wheel_x_m", "tracker.scale", "mocap.body"}
    assert all(abs(check.difference) <= check.within for check in found)


@pytest.mark.parametrize(
    ("source", "factors", "keys"),
    [
        ("odometry", (1.0, 1.0, 0.8), {"robot.wheel_x_m", "robot.wheel_y_m"}),
        ("odometry", (1.2, 1.2, 1.2), {"robot.wheel_radius_m"}),
        ("odometry", (0.8, 0.8, 0.8), {"robot.wheel_radius_m"}),
        ("tracker", (0.8, 0.8, 1.0), {"tracker.scale"}),
    ],
)
def test_a_scale_is_told_with_the_value_that_fits(source, factors, keys):
    seen = ways()
    seen[source] = seen[source] * np.array(factors)
    found = list(step_checks(CONFIG, seen, KNOWN))
    assert contradicted(found) == keys
    for check in found:
        if check.state == "contradicted":
            wrong = factors[2] if "wheel_x" in check.key or "wheel_y" in check.key else factors[0]
            fits = np.array(check.value) * (1.0 / wrong if "radius" in check.key else wrong)
            assert np.array(check.says) == pytest.approx(fits, rel=0.06)


@pytest.mark.parametrize(("step", "side"), [(0, -0.0105), (1, 0.015)])
def test_wheels_of_one_side_show_as_a_turn_where_encoders_show_the_steering(step, side):
    seen = ways()
    seen["odometry"][step, 2] += side
    assert contradicted(step_checks(CONFIG, seen, KNOWN)) == {"robot.wheel_radius_m"}


@pytest.mark.parametrize("known", [True, False])
def test_horns_of_a_robot_as_delivered_accuse_no_radius(known):
    off = np.array([0.04, -0.02, -0.03, 0.02])
    seen, x, y = ways(), np.array(CONFIG.robot.wheel_x_m), np.array(CONFIG.robot.wheel_y_m)
    seen["mocap"][0, 2] += STEP_M * x @ off / (x @ x)
    seen["mocap"][1, 2] += STEP_M * y @ off / (y @ y)
    assert not contradicted(step_checks(CONFIG, seen, off if known else UNKNOWN))


@pytest.mark.parametrize("degrees", [4.0, -4.0])
def test_a_camera_turned_about_the_normal_is_told(degrees):
    seen = ways()
    seen["tracker"] = turned(seen["tracker"], np.radians(degrees))
    found = list(step_checks(CONFIG, seen, KNOWN))
    assert contradicted(found) == {"tracker.mount_rotation_wxyz"}
    (check,) = (one for one in found if one.state == "contradicted")
    assert check.difference == pytest.approx(np.radians(degrees), abs=0.001)


def test_zeros_that_are_off_alike_are_told_from_the_body():
    seen = ways()
    for source in ("mocap", "tracker"):
        seen[source] = turned(seen[source], 0.08)
    assert contradicted(step_checks(CONFIG, seen, KNOWN)) == {"alignment.steer_zero_rad"}


def test_wheels_and_a_camera_without_motion_capture_rest_on_each_other():
    seen = ways()
    found = {
        check.key: check for check in camera_checks(CONFIG, {k: seen[k] for k in ("odometry", "tracker")})
    }
    assert found["robot.wheel_radius_m"].given == ("tracker.scale",)
    assert found["tracker.scale"].given == ("robot.wheel_radius_m",)


def test_radius_and_camera_that_are_wrong_by_one_factor_show_in_the_turn():
    seen = ways()
    found = camera_checks(
        CONFIG, {"odometry": 1.3 * seen["odometry"], "tracker": seen["tracker"] * np.array([1.3, 1.3, 1.0])}
    )
    assert contradicted(found) >= {"robot.wheel_radius_m", "tracker.scale", "robot.wheel_x_m"}


def test_a_short_watch_does_not_accuse_a_clock(tmp_path):
    """In two seconds the drift is not known to 90 ppm."""
    done = run("bring_up", tmp_path / "run", {"watch_s": 2.0}, seed=4, overrides={"loop.rate_hz": 50.0})
    assert not [name for name in done.failed if "clock" in name]
    assert done.values["tracker.clock_drift_least"] <= 90.0
    rows = {row["key"]: row for row in done.result.facts["taken_for_granted"]}
    assert rows["tracker.mount_rotation_wxyz"]["state"] == "confirmed"
    assert rows["robot.wheel_radius_m"]["within"] == 0.06


def test_an_age_of_the_bench_file_that_makes_samples_old_is_named(tmp_path):
    wrong = {"loop.rate_hz": 50.0, "imu.sample_age_s": 0.3}
    done = run("bring_up", tmp_path / "run", {"watch_s": 2.0}, seed=4, overrides=wrong)
    assert "imu.age" in done.failed, done.result
    assert any("imu.sample_age_s" in note for note in done.result.facts["notes"])


@pytest.mark.parametrize("angle_rad", [0.14, -0.14])
def test_a_plate_that_bears_imu_and_camera_is_contradicted_by_the_wheels(angle_rad):
    """Nothing but the wheels shows a camera without motion capture which way the body goes."""
    seen = ways()
    found = list(camera_checks(CONFIG, seen | {"tracker": turned(seen["tracker"], angle_rad)}))
    assert contradicted(found) == {
        "tracker.mount_rotation_wxyz",
        "imu.mount_rotation_wxyz",
        "alignment.steer_zero_rad",
    }


def test_a_camera_that_agrees_with_the_wheels_confirms_no_more_than_its_direction():
    (mount,) = (c for c in camera_checks(CONFIG, ways()) if c.key == "tracker.mount_rotation_wxyz")
    assert mount.state == "confirmed"
    assert mount.beside
    assert mount.given == ("alignment.steer_zero_rad",)
