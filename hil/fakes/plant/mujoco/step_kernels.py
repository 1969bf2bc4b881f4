"""Runs before every step of MuJoCo: servo models, friction of patches, and detection of a fall.

The servos are those of the own plant (`hil.fakes.plant.joints`: firmware, motor, limits, play), with its
constants `c`, state `s` and commands `q`; body and wheels are MuJoCo's, `qpos` (nq,) and `qvel` (nv,), with
indices in `a`. `friction` (4, 5) is that of the wheels' contacts. The torque of a steering fork is the one
that moves it, by the end of the step, to the angle given by servo and play. A spring, however stiff, would
overshoot whenever the play is taken up. A drive servo applies its torque to its wheel.
"""

import math

from hil.core.geometry import Array
from hil.core.named_records import Records
from hil.fakes.plant.joints import finish_joint, follow_references, steer_joint
from hil.fakes.plant.mujoco.named_numbers import Places
from hil.fakes.plant.named_numbers import Constants, State
from hil.fakes.plant.step_kernel import friction_factor, look_from_origin
from hil.support.numba_jit import inner, kernel

FORK_DAMPING_N_M_S = 0.6
"""Damps the forks while the robot settles; the torque of the servos compensates it afterwards."""
SLIDING_M_S = 0.02
"""A wheel with a higher slip speed is sliding; creep at full speed is 5 mm/s."""
_LIFTED_M, _TIPPED_COSINE = 0.01, math.cos(math.radians(2.0))
"""Limits of height and tilt: two wheels are then 8 mm off the surface, and the fan blows into the gap."""
_FAST, _FAR = 1e3, 1e4
CHECK_STATE = -1.0
"""Returned instead of a ratio: the robot has begun to fall, or the simulation has diverged."""


@kernel
def prepare(
    robots: Records, patches: Records, qpos: Array, qvel: Array, ctrl: Array, friction: Array
) -> float:
    """Prepare the next step.

    Args:
        robots: array (1,) of `MujocoRecord`; its body, joints, wheel headings, slip and fall state are
            updated.
        patches: array (m,) of `PatchRecord`.
        qpos: MuJoCo's positions.
        qvel: MuJoCo's velocities.
        ctrl: MuJoCo's actuator inputs; written.
        friction: friction (4, 5) of the four contact pairs; written.

    Returns:
        MuJoCo's `impratio` for the step, or `CHECK_STATE`.
    """
    robot = robots[0]
    c, s, q, p, a = robot.constants, robot.state, robot.commands, robot.settled, robot.places
    fallen = s.fallen
    look_at_body(s, qpos, qvel)
    look_at_wheels(s, a, qpos, qvel)
    follow_references(c, s, q)
    speed = 0.0
    for i in range(4):
        steer_joint(i, c, s, q)
        wanted = (s.heading[i] - qpos[a.steer_q[i]]) / c.dt
        push = p.fork_inertia[i] * (wanted - qvel[a.steer_v[i]]) / c.dt
        ctrl[a.steer_ctrl[i]] = push + FORK_DAMPING_N_M_S * wanted
        angle = s.angle[i]
        finish_joint(i, c.dt, s.rate[i], c, s, q)
        s.angle[i] = angle
        ctrl[a.drive_ctrl[i]] = c.kt[i] * s.amps[i]
        speed += 0.25 * abs(c.radius[i] * s.rate[i])
    sliding = contacts(c, s, a, patches, qpos, friction)
    way = c.dt * math.hypot(s.velocity[0], s.velocity[1])
    s.slid = s.slid + way if sliding == 4 else 0.0
    if s.slid > c.fall_slide and c.gravity > 0.0:
        s.fallen = 1.0
    cosine = 1.0 - 2.0 * (qpos[4] * qpos[4] + qpos[5] * qpos[5])
    if qpos[2] > p.height + _LIFTED_M or cosine < _TIPPED_COSINE:
        s.fallen = 1.0
    if s.fallen != fallen or (fallen == 0.0 and not is_sound(qpos, qvel)):
        return CHECK_STATE
    ratio: float = p.ratio if p.ratio_speed == 0.0 else p.ratio_speed / max(speed, p.slowest)
    return ratio


@kernel
def finish(robots: Records, qpos: Array, qvel: Array) -> None:
    """Read body and wheels after a step, and the origin's mean acceleration over the step, body axes."""
    robot = robots[0]
    c, s, a = robot.constants, robot.state, robot.places
    before_x, before_y = s.velocity[0], s.velocity[1]
    look_at_body(s, qpos, qvel)
    look_at_wheels(s, a, qpos, qvel)
    x, y = (s.velocity[0] - before_x) / c.dt, (s.velocity[1] - before_y) / c.dt
    cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
    s.origin.acceleration[0], s.origin.acceleration[1] = cosine * x + sine * y, cosine * y - sine * x
    look_from_origin(s, 0.0, 0.0)


@inner
def look_at_body(s: State, qpos: Array, qvel: Array) -> None:
    """Read the pose of the body's origin (heading without jumps) and its velocity, wall axes."""
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turned = heading - s.body[2]
    s.body[0], s.body[1] = qpos[0], qpos[1]
    s.body[2] += turned - 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
    s.velocity[0], s.velocity[1] = qvel[0], qvel[1]
    s.velocity[2] = (
        2.0 * (x * z - w * y) * qvel[3]
        + 2.0 * (y * z + w * x) * qvel[4]
        + (1.0 - 2.0 * (x * x + y * y)) * qvel[5]
    )


@inner
def look_at_wheels(s: State, a: Places, qpos: Array, qvel: Array) -> None:
    """Read angles and rates of the drives."""
    for i in range(4):
        s.angle[i], s.rate[i] = qpos[a.drive_q[i]], qvel[a.drive_v[i]]


@inner
def contacts(c: Constants, s: State, a: Places, patches: Records, qpos: Array, friction: Array) -> int:
    """Compute slip of every wheel in its own frame and friction at its place; count sliding wheels."""
    cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
    sliding = 0
    for i in range(4):
        x = cosine * c.wheel_x[i] - sine * c.wheel_y[i]
        y = sine * c.wheel_x[i] + cosine * c.wheel_y[i]
        vx, vy = s.velocity[0] - s.velocity[2] * y, s.velocity[1] + s.velocity[2] * x
        direction = s.body[2] + qpos[a.steer_q[i]]
        ahead, aside = math.cos(direction), math.sin(direction)
        s.slip[2 * i] = ahead * vx + aside * vy - c.radius[i] * s.rate[i]
        s.slip[2 * i + 1] = ahead * vy - aside * vx
        sliding += 1 if math.hypot(s.slip[2 * i], s.slip[2 * i + 1]) > SLIDING_M_S else 0
        factor = friction_factor(patches, s.body[0] + x, s.body[1] + y)
        pair = a.pair[i]
        friction[pair, 0] = friction[pair, 1] = c.friction * factor
    return sliding


@inner
def is_sound(qpos: Array, qvel: Array) -> bool:
    """Return whether the state is still plausible: finite, not faster than sound, not kilometres away."""
    for value in qvel:
        if not abs(value) < _FAST:
            return False
    return bool(abs(qpos[0]) < _FAR and abs(qpos[1]) < _FAR and abs(qpos[2]) < _FAR)
