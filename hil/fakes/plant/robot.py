"""The emulated robot body in physics of our own, and how one is made from a configuration."""

from __future__ import annotations

import math

import numpy as np

from hil.config.robot import RobotConfig
from hil.config.servo_models import DEFAULT_MODEL, ServoModel, servo_model
from hil.fakes.faults import FaultPlan
from hil.fakes.plant import kernel as k
from hil.fakes.plant.body import SteppedBody, checked_pose
from hil.fakes.plant.compiled import choose_advance
from hil.fakes.plant.parameters import TrueParameters, draw, nominal_parameters
from hil.fakes.plant.surfaces import Patch, Surface, find_surface
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.geometry import Array, ArrayLike

GRAVITY_M_S2 = 9.81
FALL_SLIDE_M = 0.05
STEP_NS = 1_000_000


class WallRobot(SteppedBody):
    """Four steered and driven wheels on an inclined plane, in physics of our own.

    Args:
        parameters: what the robot truly is.
        patches: where the surface's friction differs.
        tilt_rad, faults, step_ns, by_hand: see `SteppedBody`.
        start_pose: (3,) of the body in the wall frame, at rest.
        compiled: force the compiled (True) or the interpreted (False) physics.
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
        compiled: bool | None = None,
        by_hand: bool = False,
    ) -> None:
        constants = make_constants(parameters, patches, tilt_rad, step_ns / NS_PER_S)
        super().__init__(
            parameters, constants, tilt_rad=tilt_rad, faults=faults, step_ns=step_ns, by_hand=by_hand
        )
        self._advance = choose_advance(compiled)
        self._state[:] = _start(parameters, checked_pose(start_pose))
        self._integrate(0, 1.0)  # loads the compiled code now

    def _integrate(self, n: int, adhesion_factor: float) -> None:
        self._advance(n, adhesion_factor, self._numbers)

    def bristle_deflection_m(self) -> Array:
        """Elastic deflection of the contacts (4, 2), wall axes: where contact energy is stored."""
        return np.array(self._state[k.BRISTLE : k.BRISTLE + 8]).reshape(4, 2)


def _start(p: TrueParameters, pose: Array) -> Array:
    """State at rest at a pose, joints at zero, bristles relaxed."""
    s = np.zeros(k.STATE_SIZE)
    c, n = math.cos(pose[2]), math.sin(pose[2])
    x, y, _ = p.centre_of_mass_m
    s[k.BODY : k.BODY + 3] = pose[0] + c * x - n * y, pose[1] + n * x + c * y, pose[2]
    s[k.HEADING : k.HEADING + 4] = p.steering_offset_rad
    s[k.NEXT_SHARE : k.NEXT_SHARE + 4] = 1.0
    return s


def make_constants(p: TrueParameters, patches: tuple[Patch, ...], tilt_rad: float, dt_s: float) -> Array:
    """True parameters in the form of the physics: shape (106 + 5 per patch,), with gravity and loads."""
    x, y, height = p.centre_of_mass_m
    press_n = p.mass_kg * GRAVITY_M_S2 * math.cos(tilt_rad)
    contact, joints = p.contact, p.joints
    scalars = {
        k.DT: dt_s,
        k.MASS: p.mass_kg,
        k.INERTIA: p.yaw_inertia_kg_m2,
        k.COM_X: x,
        k.COM_Y: y,
        k.COM_HEIGHT: height,
        k.GRAVITY: GRAVITY_M_S2 * math.sin(tilt_rad),
        k.PRESS: press_n,
        k.PRESS_Y: press_n * x,
        k.PRESS_X: press_n * y,
        k.ADHESION: p.adhesion_n,
        k.THRUST: p.thrust_n,
        k.THRUST_TORQUE: p.thrust_torque_n_m,
        k.THRUST_HEIGHT: p.propeller_height_m,
        k.FRICTION: contact.friction,
        k.CREEP_ALONG: contact.creep_along,
        k.CREEP_ACROSS: contact.creep_across,
        k.SOFTENING: contact.softening,
        k.STIFFNESS: contact.stiffness_n_m,
        k.DAMPING: contact.damping_n_s_m,
        k.ROLLING: contact.rolling_resistance,
        k.SUPPLY: p.supply_v,
        k.VELOCITY_P: joints.velocity_p_v_s_rad,
        k.VELOCITY_I: joints.velocity_i_v_rad,
        k.POSITION_P: joints.position_p_v_rad,
        k.FALL_SLIDE: FALL_SLIDE_M,
    }
    load_map = np.linalg.pinv(np.stack([np.ones(4), p.wheel_x_m, p.wheel_y_m]))
    rows = {
        k.WHEEL_X: p.wheel_x_m,
        k.WHEEL_Y: p.wheel_y_m,
        k.RADIUS: p.wheel_radius_m,
        k.OFFSET: p.steering_offset_rad,
        k.PLAY: joints.play_rad,
        k.LOAD_MAP: load_map.ravel(),
        k.KT: joints.torque_constant_n_m_a,
        k.KE: joints.back_emf_v_s_rad,
        k.OHM: joints.resistance_ohm,
        k.JOINT_INERTIA: joints.inertia_kg_m2,
        k.COULOMB: joints.coulomb_n_m,
        k.VISCOUS: joints.viscous_n_m_s,
    }
    c = np.full(k.PATCHES + 5 * len(patches), np.nan)
    for at, value in scalars.items():
        c[at] = value
    for at, row in rows.items():
        c[at : at + row.size] = row
    for i, a in enumerate(patches):
        at = k.PATCHES + 5 * i
        c[at : at + 5] = a.x_min_m, a.y_min_m, a.x_max_m, a.y_max_m, a.friction_factor
    return c


def true_parameters(
    robot: RobotConfig,
    ground: Surface,
    tilt_rad: float,
    servos: ServoModel | None,
    rng: np.random.Generator,
    geometry_share: float | None,
) -> TrueParameters:
    """What the robot of a configuration truly is, in any physics: one seed is one robot.

    Args:
        robot: nominal robot.
        ground: the surface.
        tilt_rad: of the surface.
        servos: whose motors drive and steer it; XH430-W210 when None.
        rng: source of the truth's deviations from nominal.
        geometry_share: see `hil.fakes.plant.parameters.draw`; None for a truth that is the nominal robot.
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
    compiled: bool | None = None,
    by_hand: bool = False,
) -> WallRobot:
    """The robot of a configuration on a surface.

    Args:
        robot: nominal robot.
        surface: preset (`floor`, `concrete`, `melamine`, `patchy`) or one of your own.
        tilt_rad: 0 floor to pi/2 wall and beyond; the fan is off on `floor`.
        start_pose: (3,) in the wall frame.
        servos: whose motors drive and steer it; XH430-W210 where it is left out.
        rng: source of the truth's deviations from nominal.
        randomise_truth: whether the truth deviates at all.
        geometry_share: see `hil.fakes.plant.parameters.draw`.
        faults: see `WallRobot`.
        step_ns: see `WallRobot`.
        compiled: see `WallRobot`.
        by_hand: see `WallRobot`.

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
        compiled=compiled,
        by_hand=by_hand,
    )
