"""The emulated robot body: joint commands in, physical truth out, on a fixed grid of internal steps.

A command acts from the next internal step. `advance` integrates whole steps only, so that results do
not depend on how a stretch of time is split.
"""

from __future__ import annotations

import math

import numpy as np

from hil.config.robot import RobotConfig
from hil.config.servo_models import DEFAULT_MODEL, ServoModel, servo_model
from hil.fakes.faults import FaultPlan
from hil.fakes.plant import kernel as k
from hil.fakes.plant.compiled import choose_advance
from hil.fakes.plant.parameters import TrueParameters, draw, nominal_parameters
from hil.fakes.plant.surfaces import Patch, Surface, find_surface
from hil.fakes.plant_api import BodyMotion, HoldingForces, JointCommand, Plant, PlantState
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.errors import UsageError
from hil.vocabulary.geometry import Array, ArrayLike

GRAVITY_M_S2 = 9.81
FALL_SLIDE_M = 0.05
STEP_NS = 1_000_000

_MODES = {
    "off": k.MODE_OFF,
    "velocity": k.MODE_VELOCITY,
    "position": k.MODE_POSITION,
    "pwm": k.MODE_PWM,
    "current": k.MODE_CURRENT,
}


class WallRobot(Plant):
    """Four steered and driven wheels on an inclined plane.

    Args:
        parameters: what the robot truly is.
        patches: where the surface's friction differs.
        tilt_rad: 0 floor, pi/2 wall, more than that overhanging.
        start_pose: (3,) of the body in the wall frame, at rest.
        faults: answers to device `plant`, kind `adhesion_loss` with `factor` (0) of the adhesion left,
            reached along a line within `over_s` (0).
        step_ns: internal step.
        compiled: force the compiled (True) or the interpreted (False) physics.
        by_hand: somebody holds the robot until the first motor has torque; nothing moves before.
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
        self.parameters, self._by_hand = parameters, by_hand
        self.tilt_rad = tilt_rad
        self._faults = faults if faults is not None else FaultPlan()
        self._faults.declare("plant", {"adhesion_loss": ("factor", "over_s")})
        self._step_ns, self._steps = step_ns, 0
        self._advance = choose_advance(compiled)
        self._constants = make_constants(parameters, patches, tilt_rad, step_ns / NS_PER_S)
        self._state = _start(parameters, np.asarray(start_pose, dtype=np.float64))
        self._commands = np.zeros(k.COMMANDS_SIZE)
        self._commands[k.RATE_LIMIT : k.DUTY_LIMIT] = np.inf
        self._commands[k.DUTY_LIMIT :] = 1.0
        self._truth: PlantState | None = None
        self._advance(0, 1.0, self._constants, self._state, self._commands)  # loads the compiled code now
        self._motion, self._headings = (
            _view(self._state[at : at + size]) for at, size in ((k.BODY, 8), (k.HEADING, 4))
        )
        self._views = tuple(_view(self._state[at : at + 8]) for at in (k.ANGLE, k.RATE, k.AMPS))

    @property
    def t_ns(self) -> int:
        """Time up to which the body has been integrated."""
        return self._steps * self._step_ns

    def command(self, joint: int, command: JointCommand) -> None:
        """Ask a joint's motor for something, from the next internal step on.

        Raises:
            UsageError: no such joint, or a goal or limit that is not a number.
        """
        limits = (command.velocity_limit_rad_s, command.current_limit_a, command.pwm_limit)
        if not 0 <= joint < 8 or not math.isfinite(command.goal) or not all(v >= 0.0 for v in limits):
            raise UsageError(
                f"joint {joint}: {command}", expected="a joint 0..7, a finite goal and limits >= 0"
            )
        q, mode = self._commands, _MODES[command.mode]
        self._by_hand = self._by_hand and mode == k.MODE_OFF
        if mode != q[k.MODE + joint]:
            self._state[k.INTEGRAL + joint] = 0.0
        q[k.MODE + joint] = mode
        q[k.GOAL + joint] = command.goal
        q[k.RATE_LIMIT + joint], q[k.AMPS_LIMIT + joint] = limits[:2]
        q[k.DUTY_LIMIT + joint] = min(limits[2], 1.0)

    @property
    def working_point(self) -> HoldingForces:
        """What fan and propellers of this robot truly give at their nominal forces."""
        return self.parameters.working_point

    def set_adhesion(self, force_n: float) -> None:
        """The fan's force from the next internal step on.

        Raises:
            UsageError: not a finite force towards the surface.
        """
        self._constants[k.ADHESION] = _force(force_n, "the fan presses")
        self._truth = None

    def set_thrust(self, force_n: float) -> None:
        """The propellers' force along body x from the next internal step on.

        Raises:
            UsageError: not a finite force forwards.
        """
        self._constants[k.THRUST] = _force(force_n, "the propellers push")
        self._constants[k.THRUST_TORQUE] = force_n * self.parameters.thrust_lever_m
        self._truth = None

    def advance(self, t_ns: int) -> None:
        """Integrate up to `t_ns`: whole internal steps; the remainder waits."""
        end = t_ns // self._step_ns
        if end <= self._steps:
            return
        if self._by_hand:
            self._steps = end
        while self._steps < end:
            n, factor = self._stretch(end)
            self._advance(n, factor, self._constants, self._state, self._commands)
            self._steps += n

    def _stretch(self, end: int) -> tuple[int, float]:
        """Number of coming steps with one and the same adhesion factor, and that factor."""
        if self._faults.empty:
            return end - self._steps, 1.0
        factor = self._adhesion_factor(self._steps)
        after = self._steps + 1
        while after < end and self._adhesion_factor(after) == factor:
            after += 1
        return after - self._steps, factor

    def _adhesion_factor(self, step: int) -> float:
        fault = self._faults.find("plant", "adhesion_loss", step * self._step_ns)
        if fault is None:
            return 1.0
        return fault.faded(step * self._step_ns, fault.option("factor", 0.0), fault.option("over_s", 0.0))

    def joints(self) -> tuple[Array, Array, Array]:
        """Read-only views of position (8,), velocity (8,) and current (8,)."""
        position, rate, current = self._views
        return position, rate, current

    def bristle_deflection_m(self) -> Array:
        """Elastic deflection of the contacts (4, 2), wall axes: where contact energy is stored."""
        return np.array(self._state[k.BRISTLE : k.BRISTLE + 8]).reshape(4, 2)

    def truth(self) -> PlantState:
        """A frozen copy of everything, at `t_ns`; made once per internal step."""
        if self._truth is None or self._truth.t_ns != self.t_ns:
            self._truth = self._look()
        return self._truth

    def body(self) -> BodyMotion:
        """How the origin of the body moves; the physics follow the centre of mass."""
        x, y, theta, vx, vy, turn, ax, ay = self._motion.tolist()
        c, n = math.cos(theta), math.sin(theta)
        com_x, com_y, _ = self.parameters.centre_of_mass_m
        return BodyMotion(
            x - (c * com_x - n * com_y),
            y - (n * com_x + c * com_y),
            theta,
            c * vx + n * vy + turn * com_y,
            c * vy - n * vx - turn * com_x,
            turn,
            ax,
            ay,
            self.tilt_rad,
        )

    def steering_rad(self) -> list[float]:
        """True heading of each wheel in the body frame, wheel order."""
        return self._headings.tolist()  # type: ignore[no-any-return]

    def _look(self) -> PlantState:
        s = self._state.copy()
        s[k.BODY : k.BODY + 8] = self.body()[:8]
        s.setflags(write=False)
        return PlantState(
            t_ns=self.t_ns,
            pose_body_in_wall=s[k.BODY : k.BODY + 3],
            twist_body=s[k.VELOCITY : k.VELOCITY + 3],
            acceleration_body=s[k.ACCELERATION : k.ACCELERATION + 2],
            joint_position_rad=s[k.ANGLE : k.ANGLE + 8],
            joint_velocity_rad_s=s[k.RATE : k.RATE + 8],
            joint_current_a=s[k.AMPS : k.AMPS + 8],
            steering_true_rad=s[k.HEADING : k.HEADING + 4],
            normal_load_n=s[k.LOAD : k.LOAD + 4],
            slip_m_s=s[k.SLIP : k.SLIP + 8].reshape(4, 2),
            tilt_rad=self.tilt_rad,
            fallen=bool(s[k.FALLEN]),
            adhesion_n=float(self._constants[k.ADHESION]) * self._adhesion_factor(self._steps),
            thrust_n=float(self._constants[k.THRUST]),
        )


def _force(force_n: float, doing: str) -> float:
    if not (math.isfinite(force_n) and force_n >= 0.0):
        raise UsageError(f"{doing} with {force_n} N", expected="a finite force >= 0")
    return force_n


def _view(array: Array) -> Array:
    out: Array = array.view()
    out.setflags(write=False)
    return out


def _start(p: TrueParameters, pose: Array) -> Array:
    """State at rest at a pose, joints at zero, bristles relaxed."""
    if pose.shape != (3,) or not np.all(np.isfinite(pose)):
        raise UsageError(
            f"start pose {pose.tolist()}", expected="three finite numbers: x m, y m, heading rad"
        )
    s = np.zeros(k.STATE_SIZE)
    c, n = math.cos(pose[2]), math.sin(pose[2])
    x, y, _ = p.centre_of_mass_m
    s[k.BODY : k.BODY + 3] = pose[0] + c * x - n * y, pose[1] + n * x + c * y, pose[2]
    s[k.HEADING : k.HEADING + 4] = p.steering_offset_rad
    s[k.NEXT_SHARE : k.NEXT_SHARE + 4] = 1.0
    return s


def make_constants(p: TrueParameters, patches: tuple[Patch, ...], tilt_rad: float, dt_s: float) -> Array:
    """True parameters in the form of the physics: inclined gravity, load distribution, flat numbers."""
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
    model = servo_model(DEFAULT_MODEL) if servos is None else servos
    truth = nominal_parameters(robot, ground, tilt_rad, GRAVITY_M_S2, model)
    if randomise_truth:
        truth = draw(truth, robot.propeller_y_m, rng, geometry_share)
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
