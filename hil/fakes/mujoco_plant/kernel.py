"""What happens before every step of MuJoCo: servos act, friction goes by place, and the fall is judged.

Plain Python on indexed numbers, compiled by numba where that is installed. The servos are those of the own
plant (`hil.fakes.plant.kernel`: firmware, motor, limits, play), with its vectors `c` (106 + 5 per patch,),
`s` (144,) and `q` (40,); body and wheels are MuJoCo's, `qpos` (nq,) and `qvel` (nv,), found by the indices
`a` (28,). `friction` (4, 5) is that of the wheels' contacts. A steering servo takes its fork along: the
torque of a step is what brings it to where servo and play want it at the step's end. On a spring, however
stiff, it would overshoot whenever the play is taken up. A drive servo turns its wheel by its torque.
"""

from __future__ import annotations

import math

from hil.fakes.plant.kernel import (
    ACCELERATION,
    AMPS,
    ANGLE,
    BODY,
    DT,
    FALL_SLIDE,
    FALLEN,
    FRICTION,
    GRAVITY,
    HEADING,
    KT,
    PATCHES,
    RADIUS,
    RATE,
    SLID,
    SLIP,
    VELOCITY,
    WHEEL_X,
    WHEEL_Y,
    finish_joint,
    follow_references,
    look_from_origin,
    steer_joint,
)  # fmt: skip
from hil.vocabulary.geometry import Array

# Indices `a`: four each.
DRIVE_Q, DRIVE_V, DRIVE_CTRL, STEER_Q, STEER_V, STEER_CTRL, PAIR = range(0, 28, 4)

# Parameters `p`: four for the forks, then scalars.
FORK_INERTIA, RATIO_SPEED, RATIO, SLOWEST, HEIGHT = 0, 4, 5, 6, 7

FORK_DAMPING_N_M_S = 0.6
"""Of the forks, which nothing else holds while the robot is set down; the servos' torque makes up for it."""
SLIDING_M_S = 0.02
"""A wheel that moves faster than this over the surface does not hold; creep at full speed is 5 mm/s."""
_LIFTED_M, _TIPPED_COSINE = 0.01, math.cos(math.radians(2.0))
"""Two wheels are then 8 mm off the surface, and the fan blows into the gap."""
_FAST, _FAR = 1e3, 1e4
LOOK = -1.0
"""Instead of a ratio: the robot has begun to fall, or the simulation has lost its footing."""


def prepare(
    c: Array, s: Array, q: Array, p: Array, a: Array, qpos: Array, qvel: Array, ctrl: Array, friction: Array
) -> float:
    """Everything for the coming step.

    Args:
        c: constants, as in `hil.fakes.plant.kernel`.
        s: state, likewise: of it body, joints, wheel headings, slip and the fall are used here.
        q: commands, likewise.
        p: inertia of the forks about their axes, friction's regularisation, and how high the body stands.
        a: where the joints stand in MuJoCo's vectors.
        qpos: MuJoCo's positions.
        qvel: MuJoCo's velocities.
        ctrl: MuJoCo's actuator inputs; written.
        friction: (4, 5) of the four contact pairs; written.

    Returns:
        MuJoCo's `impratio` for the step, or `LOOK`.
    """
    fallen = s[FALLEN]
    look_at_body(s, qpos, qvel)
    look_at_wheels(s, a, qpos, qvel)
    follow_references(c, s, q)
    speed = 0.0
    for i in range(4):
        steer_joint(i, c, s, q)
        wanted = (s[HEADING + i] - qpos[a[STEER_Q + i]]) / c[DT]
        push = p[FORK_INERTIA + i] * (wanted - qvel[a[STEER_V + i]]) / c[DT]
        ctrl[a[STEER_CTRL + i]] = push + FORK_DAMPING_N_M_S * wanted
        angle = s[ANGLE + i]
        finish_joint(i, c[DT], s[RATE + i], c, s, q)
        s[ANGLE + i] = angle
        ctrl[a[DRIVE_CTRL + i]] = c[KT + i] * s[AMPS + i]
        speed += 0.25 * abs(c[RADIUS + i] * s[RATE + i])
    sliding = contacts(c, s, a, qpos, friction)
    way = c[DT] * math.hypot(s[VELOCITY], s[VELOCITY + 1])
    s[SLID] = s[SLID] + way if sliding == 4 else 0.0
    if s[SLID] > c[FALL_SLIDE] and c[GRAVITY] > 0.0:
        s[FALLEN] = 1.0
    cosine = 1.0 - 2.0 * (qpos[4] * qpos[4] + qpos[5] * qpos[5])
    if qpos[2] > p[HEIGHT] + _LIFTED_M or cosine < _TIPPED_COSINE:
        s[FALLEN] = 1.0
    if s[FALLEN] != fallen or (fallen == 0.0 and not is_sound(qpos, qvel)):
        return LOOK
    ratio: float = p[RATIO] if p[RATIO_SPEED] == 0.0 else p[RATIO_SPEED] / max(speed, p[SLOWEST])
    return ratio


def finish(c: Array, s: Array, a: Array, qpos: Array, qvel: Array) -> None:
    """What can be seen after a step: body, wheels, and the origin's mean acceleration over it, body axes."""
    before_x, before_y = s[VELOCITY], s[VELOCITY + 1]
    look_at_body(s, qpos, qvel)
    look_at_wheels(s, a, qpos, qvel)
    x, y = (s[VELOCITY] - before_x) / c[DT], (s[VELOCITY + 1] - before_y) / c[DT]
    cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
    s[ACCELERATION], s[ACCELERATION + 1] = cosine * x + sine * y, cosine * y - sine * x
    look_from_origin(s, 0.0, 0.0)


def look_at_body(s: Array, qpos: Array, qvel: Array) -> None:
    """Pose of the body's origin (heading without jumps) and its velocity, wall axes."""
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turned = heading - s[BODY + 2]
    s[BODY], s[BODY + 1] = qpos[0], qpos[1]
    s[BODY + 2] += turned - 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
    s[VELOCITY], s[VELOCITY + 1] = qvel[0], qvel[1]
    s[VELOCITY + 2] = (
        2.0 * (x * z - w * y) * qvel[3] + 2.0 * (y * z + w * x) * qvel[4]
        + (1.0 - 2.0 * (x * x + y * y)) * qvel[5]
    )  # fmt: skip


def look_at_wheels(s: Array, a: Array, qpos: Array, qvel: Array) -> None:
    """Angles and rates of the drives."""
    for i in range(4):
        s[ANGLE + i], s[RATE + i] = qpos[a[DRIVE_Q + i]], qvel[a[DRIVE_V + i]]


def contacts(c: Array, s: Array, a: Array, qpos: Array, friction: Array) -> int:
    """Slip of every wheel in its own frame, and friction where it stands; how many wheels slide."""
    cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
    sliding = 0
    for i in range(4):
        x = cosine * c[WHEEL_X + i] - sine * c[WHEEL_Y + i]
        y = sine * c[WHEEL_X + i] + cosine * c[WHEEL_Y + i]
        vx, vy = s[VELOCITY] - s[VELOCITY + 2] * y, s[VELOCITY + 1] + s[VELOCITY + 2] * x
        direction = s[BODY + 2] + qpos[a[STEER_Q + i]]
        ahead, aside = math.cos(direction), math.sin(direction)
        s[SLIP + 2 * i] = ahead * vx + aside * vy - c[RADIUS + i] * s[RATE + i]
        s[SLIP + 2 * i + 1] = ahead * vy - aside * vx
        sliding += 1 if math.hypot(s[SLIP + 2 * i], s[SLIP + 2 * i + 1]) > SLIDING_M_S else 0
        factor = 1.0
        for k in range(PATCHES, len(c), 5):
            if c[k] <= s[BODY] + x < c[k + 2] and c[k + 1] <= s[BODY + 1] + y < c[k + 3]:
                factor = c[k + 4]
                break
        pair = int(a[PAIR + i])
        friction[pair, 0] = friction[pair, 1] = c[FRICTION] * factor
    return sliding


def is_sound(qpos: Array, qvel: Array) -> bool:
    """Whether the simulation still describes a robot: finite, not faster than sound, not kilometres away."""
    for value in qvel:
        if not abs(value) < _FAST:
            return False
    return bool(abs(qpos[0]) < _FAR and abs(qpos[1]) < _FAR and abs(qpos[2]) < _FAR)
