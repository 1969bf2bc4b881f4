"""A camera three times as noisy as expected: the robot is stopped before the estimate leads it away."""

import numpy as np
import pytest

import hil
from hil.core.errors import SafetyStop
from hil.robot.trajectories import line

NOISE = {"emulation.tracker.position_noise_m": 0.0009, "emulation.tracker.angle_noise_rad": 0.0015}


@pytest.mark.parametrize(
    ("plant", "seed", "more"),
    [
        ("own", 23, {}),
        pytest.param("mujoco", 11, {"emulation.imu.gyro_noise_rad_s": 0.0051}, marks=pytest.mark.long),
    ],
)
def test_a_robot_is_stopped_whose_estimate_fits_neither_camera_nor_wheels(plant, seed, more):
    with hil.open_bench(
        "emulated", seed=seed, overrides={"emulation.plant": plant, **NOISE, **more}
    ) as bench:
        start = bench.settle()
        with pytest.raises(SafetyStop, match="neither the camera"):
            bench.drive(line(start, start + np.array([0.14, 0.0, 0.0]), speed_m_s=0.05), hold_s=0.5)
        pose = bench.truth().pose_body_in_wall - start
    assert abs(pose[1]) < 0.025
    assert -0.01 < pose[0] < 0.16
    assert bench.held.state == "HELD"
