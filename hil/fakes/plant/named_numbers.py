"""Named numbers of an emulated robot, as the physics reads and writes them; SI units throughout.

A robot is a block (1,) of `ROBOT`, its surface an array (m,) of `PATCH`, m >= 0. Joint order: drives FL BL BR
FR, then steers; wheel order: FL BL BR FR.
"""

from typing import Annotated

from hil.core.geometry import Array
from hil.core.named_records import Eight, Four, Record, dtype_of

MODE_OFF, MODE_VELOCITY, MODE_POSITION, MODE_PWM, MODE_CURRENT = range(5)
"""Modes of a joint."""


class PatchRecord(Record):
    """A rectangle of the surface, wall frame, and its friction relative to that of the surface."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    friction_factor: float


class Constants(Record):
    """Constants of robot and surface, and forces of fan and propellers; changed between steps only.

    Attributes:
        dt: internal step.
        com_x, com_y, com_height: centre of mass in body axes from the origin, and over the surface.
        gravity: acceleration along the surface.
        press, press_y, press_x: normal force of the weight, and its moments about the body's axes.
        adhesion, thrust, thrust_torque, thrust_height: forces of fan and propellers, moment of their
            imbalance, and height of the thrust.
        creep_along, creep_across, softening, stiffness, damping, rolling: contact law of a wheel.
        supply, velocity_p, velocity_i, position_p: voltage, and gains of the servos' control loops.
        fall_slide: sliding distance with no wheel holding after which the robot has fallen.
        offset, play: zero offset and play of the steering.
        load_map: (4, 3) normal loads by total force, M_y and M_x, row by row.
        kt, ke, ohm, joint_inertia, coulomb, viscous: constants of the joints' motors and gears.
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
    """Motion of the body's origin: pose in the wall frame; twist and acceleration in body axes."""

    pose: Annotated[Array, 3]
    twist: Annotated[Array, 3]
    acceleration: Annotated[Array, 2]


class State(Record):
    """State of the robot.

    Attributes:
        body, velocity: x, y of the centre of mass and heading, and their rates, wall axes.
        origin: motion of the body's origin.
        fallen: flag: 1 after a fall, else 0.
        slid: sliding distance with no wheel holding.
        angle, rate, amps: angle, rate and current of the joints.
        integral, reference: states of the joints' velocity and position loops.
        bristle: deflection of the contacts, wall axes, x and y of each wheel in turn.
        slip: slip velocities of the wheels in their own frames, along and across of each in turn.
        heading: headings of the wheels in the body frame.
        use: used share of each contact's grip.
        load: normal loads.
        next_share: factor by which the friction cone scales each contact's force; 1 while it holds.
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
    """Set-points of the joints' motors: mode, goal in its unit, limits; duty 0..1."""

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
