"""Builds robots in MuJoCo for tests; without the engine every test that imports this is skipped."""

from dataclasses import replace

import numpy as np
import pytest

from hil.config.robot import RobotConfig
from hil.config.servo_models import DEFAULT_MODEL, servo_model
from hil.fakes.plant.mujoco import CONTACTS, MujocoRobot, make_mujoco_plant
from hil.fakes.plant.mujoco.model import build_model
from hil.fakes.plant.parameters import nominal_parameters
from hil.fakes.plant.robot import GRAVITY_M_S2
from hil.fakes.plant.surfaces import find_surface

mujoco = pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
WEIGHT_N = 3.25 * GRAVITY_M_S2


def robot(seed=0, *, random=False, config=None, **options) -> MujocoRobot:
    """A robot, nominal unless `random`."""
    return make_mujoco_plant(
        config or RobotConfig(), rng=np.random.default_rng(seed), randomise_truth=random, **options
    )


def truth(surface, tilt_rad, **joints):
    """True parameters that equal the configuration, but for some of the joints."""
    model = servo_model(DEFAULT_MODEL)
    p = nominal_parameters(RobotConfig(), find_surface(surface), tilt_rad, GRAVITY_M_S2, model)
    return replace(p, joints=replace(p.joints, **joints))


def without_play(contact) -> MujocoRobot:
    """On the floor, with steering that reaches its goal: wheels that agree with each other."""
    coulomb = np.array([0.04] * 4 + [0.0] * 4)
    p = truth("floor", 0.0, play_rad=np.zeros(4), coulomb_n_m=coulomb)
    touch = CONTACTS[contact]
    return MujocoRobot(build_model(p, touch), p, tilt_rad=0.0)
