"""The numbers of an emulated robot by name, as the physics reads and writes them; SI units throughout.

One robot is a block (1,) of `ROBOT`, its surface an array (m,) of `PATCH`, m >= 0. Joints are the drives
FL BL BR FR, then the steers; wheels FL BL BR FR.
"""

from __future__ import annotations

from typing import Annotated

from hil.core.geometry import Array
from hil.core.named_records import Eight, Four, Record, dtype_of

MODE_OFF, MODE_VELOCITY, MODE_POSITION, MODE_PWM, MODE_CURRENT = range(5)
"""Modes of a joint."""


class PatchRecord(Record):
    """A rectangle of the surface, wall frame, and the friction in it as a share of the surface's."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    friction_factor: float


class Constants(Record):
    """What the robot and its surface are, and what fan and propellers do; changed between steps only.

    Attributes:
        dt: internal step.
        com_x, com_y, com_height: centre of mass in body axes from the origin, and over the surface.
        gravity: along the surface.
        press, press_y, press_x: the weight's force onto the surface, and its moments about the body's axes.
        adhesion, thrust, thrust_torque, thrust_height: of the fan and the propellers.
        creep_along, creep_across, softening, stiffness, damping, rolling: the law of contact of a wheel.
        supply, velocity_p, velocity_i, position_p: voltage, and gains of the servos' loops.
        fall_slide: how far it slides with no wheel holding until it has fallen.
        offset, play: of the steering.
        load_map: (4, 3) normal loads by total force, M_y and M_x, row by row.
        kt, ke, ohm, joint_inertia, coulomb, viscous: of the joints' motors and gears.
    """

    dt: float
    mass: float
    inertia: float
    com_x: float
    com_y: float
    com_height: float
    gravity: float
    press: float
    press_y: float
    press_x: float
    adhesion: float
    thrust: float
    thrust_torque: float
    thrust_height: float
    friction: float
    creep_along: float
    creep_across: float
    softening: float
    stiffness: float
    damping: float
    rolling: float
    supply: float
    velocity_p: float
    velocity_i: float
    position_p: float
    fall_slide: float
    wheel_x: Four
    wheel_y: Four
    radius: Four
    offset: Four
    play: Four
    load_map: Annotated[Array, 12]
    kt: Eight
    ke: Eight
    ohm: Eight
    joint_inertia: Eight
    coulomb: Eight
    viscous: Eight


class Motion(Record):
    """How the body's origin moves: pose in the wall frame; twist and acceleration in body axes."""

    pose: Annotated[Array, 3]
    twist: Annotated[Array, 3]
    acceleration: Annotated[Array, 2]


class State(Record):
    """Where the robot is.

    Attributes:
        body, velocity: x, y of the centre of mass and heading, and their rates, wall axes.
        origin: what can be seen of that.
        fallen: 1 once it has fallen, else 0.
        slid: how far it has slid with no wheel holding.
        angle, rate, amps: of the joints.
        integral, reference: of the joints' velocity and position loops.
        bristle: deflection of the contacts, wall axes, x and y of each wheel in turn.
        slip: of the wheels in their own frames, along and across of each in turn.
        heading: of the wheels in the body frame.
        use: share of its grip that each contact needs.
        load: normal loads.
        next_share: what the friction cone leaves of each contact's force, 1 where it holds.
        share, cosine, sine, arm_x, arm_y, grip, along, along_slope, across, across_slope, branch, free,
            compliance, spin: scratch of one step, by wheel.
    """

    body: Annotated[Array, 3]
    velocity: Annotated[Array, 3]
    origin: Motion
    fallen: float
    slid: float
    angle: Eight
    rate: Eight
    amps: Eight
    integral: Eight
    reference: Eight
    bristle: Eight
    slip: Eight
    heading: Four
    use: Four
    load: Four
    next_share: Four
    share: Four
    cosine: Four
    sine: Four
    arm_x: Four
    arm_y: Four
    grip: Four
    along: Four
    along_slope: Four
    across: Four
    across_slope: Four
    branch: Four
    free: Four
    compliance: Four
    spin: Four


class Commands(Record):
    """What the joints' motors are asked for: mode, goal in its unit, limits; duty 0..1."""

    mode: Eight
    goal: Eight
    rate_limit: Eight
    amps_limit: Eight
    duty_limit: Eight


class Robot(Record):
    """All numbers of one robot."""

    state: State
    commands: Commands
    constants: Constants


CONSTANTS, ROBOT, PATCH = dtype_of(Constants), dtype_of(Robot), dtype_of(PatchRecord)
