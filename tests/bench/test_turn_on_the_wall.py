"""A turn on the wall that the friction of a wheel does not allow is refused before the drive."""

import numpy as np
import pytest

import hil
from hil.bench.loop_settings import motion_limits
from hil.config.loading import load_bench
from hil.core.errors import TrajectoryError
from hil.robot.trajectories import line


@pytest.mark.parametrize(("seed", "plant"), [(1, "own"), (2, "mujoco")])
def test_the_steepest_heading_that_is_accepted_is_driven(seed, plant):
    overrides = {"emulation.plant": plant, "loop.rate_hz": 50.0}
    with hil.open_bench("emulated", overrides=overrides, seed=seed) as bench:
        start, (_, most_rad) = bench.settle(), motion_limits(bench.config).friction_rad
        bench.drive(line(start, np.array([*start[:2], most_rad - 0.001])), hold_s=0.5)
        assert bench.truth().pose_body_in_wall[2] == pytest.approx(most_rad, abs=0.01)
        here = bench.settle()
        with pytest.raises(TrajectoryError, match=r"safety\.utilisation_limit"):
            bench.drive(line(here, np.array([*here[:2], 0.24])))
        bench.drive(line(here, np.array([*here[:2], 0.1])), hold_s=0.1)


def test_the_limit_is_where_a_wheel_uses_its_share_and_only_on_a_wall():
    low_rad, high_rad = motion_limits(load_bench("emulated")).friction_rad
    assert -0.2618 <= low_rad < -high_rad < -0.2, "propellers push this robot round to one side"
    assert motion_limits(load_bench("emulated_floor")).friction_rad is None
    tethered = load_bench("emulated", overrides={"safety.tethered": True})
    assert motion_limits(tethered).friction_rad is None
    strong = load_bench("emulated", overrides={"adhesion.force_n": 55.0})
    assert motion_limits(strong).friction_rad[1] > high_rad
