"""The emulated robot body with the project's own physics, and how to make one from a configuration."""

import math
from dataclasses import astuple

import numpy as np

from hil.config.robot import RobotConfig
from hil.config.servo_models import DEFAULT_MODEL, ServoModel, servo_model
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, ArrayLike
from hil.core.named_records import Records, filled
from hil.fakes.plant.common_body import SteppedBody, checked_pose
from hil.fakes.plant.named_numbers import CONSTANTS, PATCH, ROBOT
from hil.fakes.plant.parameters import TrueParameters, draw, nominal_parameters
from hil.fakes.plant.step_kernel import advance
from hil.fakes.plant.surfaces import Patch, Surface, find_surface
from hil.faults.plan import FaultPlan

GRAVITY_M_S2 = 9.81
FALL_SLIDE_M = 0.05
STEP_NS = 1_000_000


class WallRobot(SteppedBody):
    """Four steered and driven wheels on an inclined plane, with the project's own physics.

    Args:
        parameters: true parameters of the robot.
        patches: areas with other friction.
        tilt_rad, faults, step_ns, by_hand: arguments of `SteppedBody`.
        start_pose: pose (3,) of the body in the wall frame; it starts at rest.
    """

    def __init__(
        self,
        parameters: TrueParameters,
        *,
        patches: tuple[Patch, ...] = (),
        tilt_rad: float = math.pi / 2.0,
        start_pose: ArrayLike = (0.0, 0.0, 0.0),
        faults: FaultPlan | None = None,
        step_ns: int = STEP_NS,
        by_hand: bool = False,
    ) -> None:
        robots = np.zeros(1, ROBOT)
        robots["constants"] = make_constants(parameters, tilt_rad, step_ns / NS_PER_S)
        super().__init__(
            parameters, robots, tilt_rad=tilt_rad, faults=faults, step_ns=step_ns, by_hand=by_hand
        )
        self._patches = make_patches(patches)
        self._start(checked_pose(start_pose))
        self._integrate(0, 1.0)  # loads the machine code now

    def _integrate(self, n: int, adhesion_factor: float) -> None:
        advance(self._robots, self._patches, n, adhesion_factor)

    def bristle_deflection_m(self) -> Array:
        """Elastic deflection of the contacts (4, 2), wall axes, m; it stores the contact energy."""
        return np.array(self._state.bristle).reshape(4, 2)

    def _start(self, pose: Array) -> None:
        """Start at rest at a pose, with joints at zero and bristles relaxed."""
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x, y, _ = self.parameters.centre_of_mass_m
        s = self._state
        s.body[:] = pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y, pose[2]
        s.heading[:] = self.parameters.steering_offset_rad
        s.next_share[:] = 1.0


def make_constants(p: TrueParameters, tilt_rad: float, dt_s: float) -> Records:
    """Return true parameters as (1,) of `Constants`, with gravity and loads."""
    x, y, height = p.centre_of_mass_m
    press_n = p.mass_kg * GRAVITY_M_S2 * math.cos(tilt_rad)
    contact, joints = p.contact, p.joints
    scalars = {
        "dt": dt_s,
        "mass": p.mass_kg,
        "inertia": p.yaw_inertia_kg_m2,
        "com_x": x,
        "com_y": y,
        "com_height": height,
        "gravity": GRAVITY_M_S2 * math.sin(tilt_rad),
        "press": press_n,
        "press_y": press_n * x,
        "press_x": press_n * y,
        "adhesion": p.adhesion_n,
        "thrust": p.thrust_n,
        "thrust_torque": p.thrust_torque_n_m,
        "thrust_height": p.propeller_height_m,
        "friction": contact.friction,
        "creep_along": contact.creep_along,
        "creep_across": contact.creep_across,
        "softening": contact.softening,
        "stiffness": contact.stiffness_n_m,
        "damping": contact.damping_n_s_m,
        "rolling": contact.rolling_resistance,
        "supply": p.supply_v,
        "velocity_p": joints.velocity_p_v_s_rad,
        "velocity_i": joints.velocity_i_v_rad,
        "position_p": joints.position_p_v_rad,
        "fall_slide": FALL_SLIDE_M,
    }
    load_map = np.linalg.pinv(np.stack([np.ones(4), p.wheel_x_m, p.wheel_y_m]))
    rows = {
        "wheel_x": p.wheel_x_m,
        "wheel_y": p.wheel_y_m,
        "radius": p.wheel_radius_m,
        "offset": p.steering_offset_rad,
        "play": joints.play_rad,
        "load_map": load_map.ravel(),
        "kt": joints.torque_constant_n_m_a,
        "ke": joints.back_emf_v_s_rad,
        "ohm": joints.resistance_ohm,
        "joint_inertia": joints.inertia_kg_m2,
        "coulomb": joints.coulomb_n_m,
        "viscous": joints.viscous_n_m_s,
    }
    return filled(CONSTANTS, {**scalars, **rows})


def make_patches(patches: tuple[Patch, ...]) -> Records:
    """Return the patches of a surface as (m,) of `PatchRecord`."""
    return np.array(list(map(astuple, patches)), PATCH)


def true_parameters(
    robot: RobotConfig,
    ground: Surface,
    tilt_rad: float,
    servos: ServoModel | None,
    rng: np.random.Generator,
    geometry_share: float | None,
) -> TrueParameters:
    """Return the true parameters of a configured robot, equal for all physics engines with the same seed.

    Args:
        robot: nominal robot.
        ground: the surface.
        tilt_rad: tilt of the surface.
        servos: model of its servos; XH430-W210 when None.
        rng: source of the truth's deviations from nominal.
        geometry_share: share of the drawn deviations, see `hil.fakes.plant.parameters.draw`; None for nominal
            parameters.
    """
    model = servo_model(DEFAULT_MODEL) if servos is None else servos
    nominal = nominal_parameters(robot, ground, tilt_rad, GRAVITY_M_S2, model)
    return nominal if geometry_share is None else draw(nominal, robot.propeller_y_m, rng, geometry_share)


def make_plant(
    robot: RobotConfig,
    *,
    surface: str | Surface = "melamine",
    tilt_rad: float = math.pi / 2.0,
    start_pose: ArrayLike = (0.0, 0.0, 0.0),
    servos: ServoModel | None = None,
    rng: np.random.Generator,
    randomise_truth: bool = True,
    geometry_share: float = 1.0,
    faults: FaultPlan | None = None,
    step_ns: int = STEP_NS,
    by_hand: bool = False,
) -> WallRobot:
    """Return the robot of a configuration on a surface.

    Args:
        robot: nominal robot.
        surface: preset (`floor`, `concrete`, `melamine`, `patchy`) or one of your own.
        tilt_rad: tilt of the surface: 0 floor to pi/2 wall and beyond; the fan is off on `floor`.
        start_pose: start pose (3,) in the wall frame.
        servos: model of its servos; XH430-W210 by default.
        rng: source of the truth's deviations from nominal.
        randomise_truth: True if the truth deviates from nominal.
        geometry_share: share of the drawn deviations, see `hil.fakes.plant.parameters.draw`.
        faults: fault plan, see `WallRobot`.
        step_ns: internal step, see `WallRobot`.
        by_hand: True for a robot held by hand, see `WallRobot`.

    Raises:
        UsageError: unknown surface or impossible pose.
    """
    ground = find_surface(surface) if isinstance(surface, str) else surface
    share = geometry_share if randomise_truth else None
    truth = true_parameters(robot, ground, tilt_rad, servos, rng, share)
    return WallRobot(
        truth,
        patches=ground.patches,
        tilt_rad=tilt_rad,
        start_pose=start_pose,
        faults=faults,
        step_ns=step_ns,
        by_hand=by_hand,
    )
