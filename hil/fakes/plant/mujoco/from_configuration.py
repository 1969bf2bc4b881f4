"""Makes a robot in MuJoCo from a configuration; its true parameters are drawn as for the own plant.

A seed gives the same robot in both engines: deviations of geometry, masses, motors, fan and propellers are
equal. The contact of wheels and surface, which differs between them, is drawn last from the same stream.
"""

import math
from pathlib import Path

import numpy as np

from hil.config.robot import RobotConfig
from hil.config.servo_models import ServoModel
from hil.core.geometry import ArrayLike
from hil.fakes.plant.mujoco.contact_settings import CONTACTS, ContactSetting
from hil.fakes.plant.mujoco.model import build_model
from hil.fakes.plant.mujoco.robot import MujocoRobot
from hil.fakes.plant.robot import true_parameters
from hil.fakes.plant.surfaces import Surface, find_surface
from hil.faults.plan import FaultPlan


def make_mujoco_plant(
    robot: RobotConfig,
    *,
    surface: str | Surface = "melamine",
    contact: str | ContactSetting = "creep",
    tilt_rad: float = math.pi / 2.0,
    start_pose: ArrayLike = (0.0, 0.0, 0.0),
    servos: ServoModel | None = None,
    rng: np.random.Generator,
    randomise_truth: bool = True,
    geometry_share: float = 1.0,
    faults: FaultPlan | None = None,
    mjcf: Path | None = None,
    step_s: float | None = None,
    by_hand: bool = False,
) -> MujocoRobot:
    """Return the robot of a configuration on a surface.

    Args:
        robot: nominal robot.
        surface: preset (`floor`, `concrete`, `melamine`, `patchy`) or one of your own; friction and patches.
        contact: `creep`, `holding`, or one of your own.
        tilt_rad: tilt of the surface: 0 floor to pi/2 wall and beyond; the fan is off on `floor`.
        start_pose: start pose (3,) in the wall frame.
        servos: model of its servos; XH430-W210 by default.
        rng: source of the truth's deviations from nominal.
        randomise_truth: True if the truth deviates from nominal.
        geometry_share: share of the drawn deviations, see `hil.fakes.plant.parameters.draw`.
        faults: fault plan, see `SteppedBody`.
        mjcf: file of the user's own robot, which gives masses and places of wheels.
        step_s: internal step; by default that of the user's file, or 1 ms.
        by_hand: True for a robot held by hand, see `SteppedBody`.

    Raises:
        ConfigError: MuJoCo is missing, or the file does not describe a suitable robot.
        UsageError: unknown surface or impossible pose.
    """
    ground = find_surface(surface) if isinstance(surface, str) else surface
    touch = CONTACTS[contact] if isinstance(contact, str) else contact
    share = geometry_share if randomise_truth else None
    truth = true_parameters(robot, ground, tilt_rad, servos, rng, share)
    if randomise_truth:
        touch = touch.drawn(rng)
    return MujocoRobot(
        build_model(truth, touch, robot, mjcf, step_s),
        truth,
        patches=ground.patches,
        tilt_rad=tilt_rad,
        start_pose=start_pose,
        faults=faults,
        by_hand=by_hand,
    )
