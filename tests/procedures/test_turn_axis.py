"""A turn of the body shows the rest of a mount: what gravity cannot, and the place of the camera."""

import numpy as np
import pytest

import hil
from hil.config.assumed_parameters import turned
from hil.core.geometry import multiplied
from hil.procedures.bring_up import Parameters, steps
from hil.procedures.bring_up.turn_axis import place_checks, turn_checks

ONE = (1.0, 0.0, 0.0, 0.0)
NOISY = {"emulation.imu.gyro_noise_rad_s": 0.0051, "emulation.tracker.angle_noise_rad": 0.0015}


def seen(overrides, seed=0, turn_deg=6.0):
    """What one turn on the wall says about the mounts, by key."""
    with hil.open_bench("emulated", overrides=overrides, seed=seed) as bench:
        start = bench.settle()
        turn = steps(Parameters(turn_deg=turn_deg), start)[2]
        motion = bench.drive(turn, feedback="odometry", hold_s=0.5, start_pose=start)
        return {check.key: check for check in turn_checks(bench.config, motion, np.radians(turn_deg))}


@pytest.mark.parametrize("device", ["imu", "tracker"])
@pytest.mark.parametrize("degrees", [12.0, -40.0])
def test_a_turn_about_the_vertical_is_found_with_the_right_mount(device, degrees):
    key = f"{device}.mount_rotation_wxyz"
    wrong = turned("x", degrees)(ONE)
    found = seen({key: wrong, f"emulation.{key}": ONE})
    assert {name for name, check in found.items() if check.state == "contradicted"} == {key}
    assert found[key].difference == pytest.approx(np.radians(abs(degrees)), abs=0.02)
    w, x, y, z = multiplied(found[key].says, ONE)
    assert 2.0 * np.arctan2(np.linalg.norm([x, y, z]), abs(w)) < 0.02


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("noise", [{}, NOISY])
def test_right_mounts_are_confirmed(seed, noise):
    found = seen(noise, seed)
    assert {check.state for check in found.values()} == {"confirmed"}
    assert set(found) == {"imu.mount_rotation_wxyz", "tracker.mount_rotation_wxyz"}
    assert all(check.beside for check in found.values()), "gravity has to show the rest"


@pytest.mark.parametrize(
    ("lever_m", "state"), [(0.01, "confirmed"), (0.04, None), (0.1, "contradicted"), (2.0, None)]
)
def test_the_place_of_the_camera_shows_as_a_lever(lever_m, state):
    config = hil.open_bench("emulated").config
    assert [check.state for check in place_checks(config, lever_m)] == ([state] if state else [])
