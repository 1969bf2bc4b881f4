"""Noisy sensors are believed less; an estimate that fits neither camera nor wheels stops the robot."""

import numpy as np
import pytest

import hil
from hil.core.errors import SafetyStop
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


def test_a_robot_is_stopped_whose_estimate_fits_neither_camera_nor_wheels():
    """A bench file by which the robot hardly accelerates: the estimate stays behind wheels and camera."""
    stiff = {"estimator.process.acceleration_m_s2_sqrt_hz": 1e-4}
    with hil.open_bench("emulated", seed=3, overrides=stiff) as bench:
        start = bench.settle()
        with pytest.raises(SafetyStop, match="neither the camera"):
            drive(bench, start)
        pose = bench.truth().pose_body_in_wall - start
    assert np.hypot(*pose[:2]) < 0.03
    assert bench.held.state == "HELD"
