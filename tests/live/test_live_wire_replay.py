"""A recording drives the emulated devices: drivers, estimator and loop run on what a robot did."""

import os
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.core.errors import ConfigError, DataError
from hil.datasets.read import read_recordings
from hil.fakes.plant import RecordedMotion, RecordedRobot
from hil.robot.kinematics import NOMINAL_RADIUS_M, WheelGeometry

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data")) / "4wis4wid"
PUBLIC = DATA / "odom_21.csv.gz"
AFTER_S = 1.5
SECOND = 1_000_000_000

pytestmark = [
    pytest.mark.timeout(900),  # the first process to start may compile the estimators
    pytest.mark.usefixtures("warm_commands"),
]


def eased(t_s, length_s):
    """Smooth from 0 to 1, with its rate."""
    x = np.clip(t_s / length_s, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def turn_and_go(duration_s=6.0, rest_s=0.5):
    """The robot turns by 0.4 rad on the spot, wheels tangential; angles and poses at 60 Hz."""
    t_s = np.arange(0.0, duration_s + 2 * rest_s, 1 / 60)
    theta = 0.4 * eased(t_s - rest_s, duration_s)
    geometry = WheelGeometry.nominal()
    arm_m = np.hypot(geometry.x_m, geometry.y_m)
    steering = np.arctan2(geometry.x_m, -geometry.y_m)
    back = np.abs(steering) > np.pi / 2
    steering = np.where(back, steering - np.sign(steering) * np.pi, steering)
    angle = theta[:, None] * np.where(back, -1.0, 1.0) * arm_m / NOMINAL_RADIUS_M
    joints = np.hstack([angle, np.broadcast_to(steering, (len(t_s), 4))])
    pose = np.column_stack([np.zeros_like(t_s), np.zeros_like(t_s), theta])
    return RecordedMotion("turn", t_s, joints, t_s, pose)


def write_plain(path, motion):
    columns = ["t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)), "x", "y", "theta"]
    rows = np.column_stack([motion.t_s, motion.joint_rad, motion.pose])
    text = [",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(text) + "\n")
    return path


def test_the_robot_is_where_it_was_and_as_fast():
    """Rates and accelerations are those of the known motion, before and after it stands still."""
    motion = turn_and_go()
    robot = RecordedRobot(motion, tilt_rad=0.0, after_s=1.0)
    robot.advance(SECOND // 2)
    assert not robot.truth().twist_body.any()
    for t_s in (1.2, 2.5, 3.5, 5.0):
        robot.advance(round((1.0 + t_s) * SECOND))
        x = (t_s - 0.5) / 6.0
        truth = robot.truth()
        assert truth.pose_body_in_wall[2] == pytest.approx(0.4 * x * x * (3 - 2 * x), abs=2e-4)
        assert truth.twist_body[2] == pytest.approx(0.4 * 6 * x * (1 - x) / 6.0, abs=2e-3)
        np.testing.assert_allclose(robot.joints()[0], truth.joint_position_rad)
    robot.advance(20 * SECOND)
    np.testing.assert_allclose(robot.joints()[0], motion.joint_rad[-1], atol=1e-6)
    assert not robot.joints()[1].any()


def test_body_axes_follow_the_heading():
    """A robot that moves along wall y with the heading pi/2 moves ahead."""
    t_s = np.arange(0.0, 4.0, 0.01)
    pose = np.column_stack([np.zeros_like(t_s), 0.05 * t_s**2, np.full_like(t_s, np.pi / 2)])
    robot = RecordedRobot(
        RecordedMotion("ahead", t_s, np.zeros((len(t_s), 8)), t_s, pose), tilt_rad=0.0, after_s=0.0
    )
    robot.advance(2 * SECOND)
    truth = robot.truth()
    np.testing.assert_allclose(truth.twist_body, [0.2, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(truth.acceleration_body, [0.1, 0.0], atol=1e-4)


def test_drivers_and_estimator_see_the_recorded_motion(tmp_path):
    motion = turn_and_go()
    path = write_plain(tmp_path / "turn_1.csv", motion)
    overrides = {"emulation.replay": str(path), "emulation.replay_after_s": AFTER_S}
    with hil.open_bench("emulated_floor", seed=3, overrides=overrides) as bench:
        start = bench.settle()
        seen = bench.observe(AFTER_S + 7.5, feedback="ekf", start_pose=start)
        last = bench.devices.servos.read()[-1]
    assert seen.estimate[-1][2] == pytest.approx(0.4, abs=0.01)
    assert np.hypot(*seen.estimate[-1][:2]) < 0.01
    mocap = seen.mocap[np.isfinite(seen.mocap[:, 0])]
    np.testing.assert_allclose(mocap[-1], motion.pose[-1], atol=3e-4)
    first = seen.records[0].inputs.servos[-1]
    travel = last.position_rad - first.position_rad
    np.testing.assert_allclose(travel, motion.joint_rad[-1] - motion.joint_rad[0], atol=4e-3)
    np.testing.assert_allclose(last.position_rad[4:], motion.joint_rad[-1][4:], atol=2e-3)
    rates = [(m.stamp.t_ns, m.yaw_rate_rad_s) for r in seen.records for m in r.measurements.gyro]
    times, rate = np.array(rates).T
    assert np.trapezoid(rate, times / SECOND) == pytest.approx(0.4, abs=0.02)


@pytest.mark.skipif(not PUBLIC.exists(), reason=f"the public recordings are not in {DATA}")
def test_a_public_recording_goes_through_the_wires():
    """Ten seconds of a real robot's turn: what comes out of the drivers is what was recorded."""
    recording = read_recordings([PUBLIC])[0]
    overrides = {"emulation.replay": str(PUBLIC), "emulation.replay_after_s": AFTER_S}
    with hil.open_bench("emulated_floor", seed=3, overrides=overrides) as bench:
        seen = bench.observe(AFTER_S + 9.0, feedback="ekf", start_pose=recording.truth_pose[0])
    samples = [r.inputs.servos[-1] for r in seen.records]
    t_s = recording.t_s[0] + samples[-1].stamp.t_ns / SECOND - AFTER_S
    travel = [np.interp(t_s, recording.t_s, c) - c[0] for c in recording.wheel_angle_rad.T]
    np.testing.assert_allclose(samples[-1].position_rad[:4] - samples[0].position_rad[:4], travel, atol=0.02)
    known = np.isfinite(seen.mocap[:, 0])
    error = seen.estimate[known] - seen.mocap[known]
    assert np.abs(seen.mocap[known][-1][2]) > 0.5
    assert np.sqrt(np.mean(error[:, 2] ** 2)) < 0.01
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.01


def test_what_cannot_be_repeated_is_named(tmp_path):
    short = turn_and_go(duration_s=0.5, rest_s=0.1)
    with pytest.raises(DataError, match="too short"):
        RecordedRobot(short, tilt_rad=0.0, after_s=0.0)
    for number, rest_s in ((1, 0.6), (2, 0.7)):
        write_plain(tmp_path / f"turn_{number}.csv", turn_and_go(rest_s=rest_s))
    with pytest.raises(ConfigError, match="2 recordings"):
        hil.open_bench("emulated_floor", overrides={"emulation.replay": str(tmp_path)})
    with pytest.raises(DataError, match=r"emulation\.replay: .*no\.csv: does not exist"):
        hil.open_bench("emulated_floor", overrides={"emulation.replay": str(tmp_path / "no.csv")})
