"""What the statics of `hil.robot` say of loads and of tipping, held against the plant, which has its own."""

import math

import numpy as np
import pytest
from plant_driving import MS_NS, build

from hil.config.robot import RobotConfig

STICKY = 1000.0
"""A friction at which nothing slides: what is left is tipping."""
TALL = {"centre_of_mass_m": (-0.049, -0.03, 0.2), "propeller_height_m": 0.02, "thrust_compensation": 0.4}
CROOKED = {"wheel_x_m": (0.11, -0.13, -0.10, 0.14), "wheel_y_m": (0.12, 0.10, -0.11, -0.09)}
POSTURES = [
    (math.pi, 0.0, {}),
    (math.pi, 0.7, {}),
    (2.4, -0.5, {}),
    (math.pi / 2, 0.0, TALL),
    (math.pi / 2, 0.2, TALL),
    (1.9, -0.2, TALL),
    (math.pi, 0.3, CROOKED),
    (math.pi / 2, -0.1, {**TALL, **CROOKED}),
]


def after_a_moment(robot, force_n, tilt_rad, heading_rad):
    """What the plant says before anything can have slid."""
    plant = build(config=robot, tilt_rad=tilt_rad, start_pose=(0.0, 0.0, heading_rad))
    plant.set_adhesion(force_n)
    plant.advance(MS_NS)
    return plant.truth()


@pytest.mark.parametrize(("tilt_rad", "heading_rad", "changed"), POSTURES)
def test_it_tips_where_the_plant_tips(tilt_rad, heading_rad, changed):
    robot = RobotConfig(**changed)
    low_n, high_n = 0.0, 400.0
    assert after_a_moment(robot, low_n, tilt_rad, heading_rad).fallen
    assert not after_a_moment(robot, high_n, tilt_rad, heading_rad).fallen
    while high_n - low_n > 0.01:
        middle_n = 0.5 * (low_n + high_n)
        if after_a_moment(robot, middle_n, tilt_rad, heading_rad).fallen:
            low_n = middle_n
        else:
            high_n = middle_n
    thrust_n = after_a_moment(robot, high_n, tilt_rad, heading_rad).thrust_n
    needed_n = robot.statics(tilt_rad, STICKY).needed_n(thrust_n, heading_rad)
    assert needed_n == pytest.approx(high_n, abs=0.02)


@pytest.mark.parametrize(("tilt_rad", "heading_rad", "changed"), POSTURES)
@pytest.mark.parametrize("beyond", [1.02, 1.2, 2.0])
def test_wheels_that_are_left_carry_what_the_plant_says(tilt_rad, heading_rad, changed, beyond):
    robot = RobotConfig(**changed)
    statics = robot.statics(tilt_rad, STICKY)
    thrust_n = after_a_moment(robot, 400.0, tilt_rad, heading_rad).thrust_n
    force_n = beyond * statics.needed_n(thrust_n, heading_rad)
    truth = after_a_moment(robot, force_n, tilt_rad, heading_rad)
    loads_n = statics.loads_n(force_n, thrust_n, heading_rad)
    np.testing.assert_allclose(loads_n, truth.normal_load_n, rtol=1e-6, atol=1e-4)
    assert sum(loads_n) == pytest.approx(force_n + robot.weight_n * math.cos(tilt_rad))


def test_friction_is_what_counts_on_the_shipped_wall():
    robot = RobotConfig()
    thrust_n = robot.thrust_compensation * robot.weight_n
    assert robot.statics(math.pi / 2).needed_n(thrust_n, 0.0) == pytest.approx(0.3 * robot.weight_n / 0.45)
    assert robot.statics(math.pi, STICKY).needed_n(thrust_n, 0.0) > robot.weight_n


@pytest.mark.parametrize(("tilt_rad", "heading_rad", "changed"), POSTURES)
def test_a_force_for_a_share_of_the_friction_holds_too(tilt_rad, heading_rad, changed):
    """On a ceiling nothing pulls along the surface: it is tipping that asks for force."""
    statics = RobotConfig(**changed).statics(tilt_rad, 0.45)
    force_n = statics.force_for_n(0.8, 0.0, heading_rad)
    assert math.isfinite(force_n)
    assert force_n >= statics.needed_n(0.0, heading_rad)
    assert max(statics.utilisation(force_n, 0.0, heading_rad)) < 0.81


def test_a_fan_outside_of_the_wheels_never_holds_what_tips():
    """All wheels ahead of the fan: the harder it pulls, the sooner the robot goes over."""
    robot = RobotConfig(wheel_x_m=(0.3, 0.1, 0.1, 0.3))
    statics = robot.statics(math.pi / 2, STICKY)
    assert statics.needed_n(0.0, 0.0) == statics.force_for_n(0.8, 0.0, 0.0) == math.inf
