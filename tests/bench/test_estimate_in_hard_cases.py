"""Estimates of robots with noisy sensors, and of robots that move otherwise than the filter expects."""

import numpy as np
import pytest

import hil
from hil.robot.trajectories import line

NOISY = {"emulation.tracker.position_noise_m": 0.0009, "emulation.tracker.angle_noise_rad": 0.0015}
NOISY_GYRO = {"emulation.imu.gyro_noise_rad_s": 0.0051}


def drive(bench, start):
    way = line(start, start + np.array([0.14, 0.0, 0.0]), speed_m_s=0.05)
    return bench.drive(way, hold_s=0.5)


@pytest.mark.parametrize(
    ("plant", "seed", "more"),
    [
        ("own", 23, {}),
        ("own", 11, NOISY_GYRO),
        pytest.param("mujoco", 11, NOISY_GYRO, marks=pytest.mark.long),
    ],
)
def test_sensors_three_times_as_noisy_as_expected_are_named_and_give_a_good_estimate(plant, seed, more):
    with hil.open_bench("emulated", seed=seed, overrides={"emulation.plant": plant} | NOISY | more) as bench:
        start = bench.settle()
        motion = drive(bench, start)
        off_m = motion.estimate[-1, :2] - bench.truth().pose_body_in_wall[:2]
    sigma_m = np.sqrt(motion.covariance[-1, :2, :2].trace())
    assert np.hypot(*off_m) < 3.0 * sigma_m < 0.003
    assert 0.7 < motion.diagnostic("nis_mean_tracker")[-1] < 1.4
    said = {event.source: event.message for event in motion.events if "as noisy as" in event.message}
    assert set(said) == {"tracker", "imu"} if more else {"tracker"}
    for message in said.values():
        assert float(message.split()[0]) == pytest.approx(3.0, abs=0.4)


def test_an_estimate_follows_its_sensors_where_the_bench_file_says_that_the_robot_hardly_accelerates():
    stiff = {"estimator.process.acceleration_m_s2_sqrt_hz": 1e-4}
    with hil.open_bench("emulated", seed=3, overrides=stiff) as bench:
        start = bench.settle()
        motion = drive(bench, start)
        off_m = motion.estimate[-1, :2] - bench.truth().pose_body_in_wall[:2]
    assert motion.diagnostic("rejected_wheels")[-1] > 0
    assert np.hypot(*off_m) < 0.01


def test_a_hard_turn_is_no_reason_to_believe_one_wheel_against_all_others():
    """Modules turn by 80 deg while the reference goes on, then the wheels catch up with 4 rad/s^2."""
    with hil.open_bench("emulated", seed=1) as bench:
        start = bench.settle()
        corner = start + np.array([0.0, 0.1, 0.0])
        bench.drive(line(start, corner, speed_m_s=0.09), hold_s=0.3)
        stands = bench.settle()
        turned = stands + np.array([0.0, 0.0, np.radians(6.0)])
        motion = bench.drive(line(stands, turned, speed_m_s=0.03), hold_s=0.5)
    truth = np.array([record.truth["pose_body_in_wall"] for record in motion.records])
    off = motion.estimate - truth
    assert np.abs(np.diff(truth[:, 2], n=2)).max() > 3e-4, "hard: 3 rad/s^2"
    assert np.abs(off[:, 2]).max() < 0.02
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.005
