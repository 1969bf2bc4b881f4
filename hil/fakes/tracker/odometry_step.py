"""One step of the emulated visual odometry, in flat vectors.

What the camera's way is comes by name; other numbers stand in three vectors in SI units at the places named
below: what errs, the levelled world as `VisualOdometry` has fixed it, and the state.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.core.geometry import Array
from hil.support.numba_jit import inner, kernel

# What errs (7,): stated here, filled in this order by `VisualOdometry.__init__` from the truth options.
(YAW_RATE, YAW_WALK, POSITION_WALK, POSITION_NOISE, VELOCITY_NOISE, RATE_NOISE, ANGLE_NOISE) = range(7)

# The levelled world (17,): the wall's axes in it, and the parts of the camera's rotation (w, x, y, z) that go
# with cosine and sine of half the body's heading. Filled by `VisualOdometry._start`, as is the state.
ALONG_X, ALONG_Y, ALONG_Z, COSINE_PART, SINE_PART = 0, 3, 6, 9, 13
WORLD_SIZE = 17

# State (6,): position in the levelled world, place in the wall that was seen last, heading error.
POSITION, LAST_X, LAST_Y, YAW = 0, 3, 4, 5
STATE_SIZE = 6

DRAWS = 16
"""Numbers of one row of noise."""

Pose = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]


class Way(NamedTuple):
    """How the camera moves, in the wall's axes.

    Attributes:
        theta, omega: true heading of the body, and its rate.
        x, y: place of the camera.
        along, left: its velocity along wall x and y.
        speed: the length of both.
        dt: since the last pose.
        scale: factor on what is seen.
        wheel_x, wheel_y: step by wheel odometry.
        weight: of these, 0 for none.
    """

    theta: float = 0.0
    omega: float = 0.0
    x: float = 0.0
    y: float = 0.0
    along: float = 0.0
    left: float = 0.0
    speed: float = 0.0
    dt: float = 0.0
    scale: float = 1.0
    wheel_x: float = 0.0
    wheel_y: float = 0.0
    weight: float = 0.0


@kernel
def step(way: Way, draws: Array, row: int, errors: Array, world: Array, state: Array) -> Pose:
    """Move as the odometry sees it, and return the pose that it reports.

    The step is scaled, turned by the heading error and walks; wheel odometry pulls it towards
    itself.

    Args:
        way: of the camera since the last pose; its numbers in a plain tuple will do.
        draws: noise, standard normal (n, 16).
        row: of the noise, that is this pose's.
        errors: (7,).
        world: (17,).
        state: (6,), which it changes.

    Returns:
        position (3,), velocity (3,), rotation x y z w, angular velocity (3,) in the T265's axes.
    """
    way = Way(*way)
    noise, dt, scale = draws[row], way.dt, way.scale
    along, left, omega = way.along, way.left, way.omega
    root = math.sqrt(dt)
    state[YAW] += errors[YAW_RATE] * dt + errors[YAW_WALK] * root * noise[0]
    du, dv = scale * (way.x - state[LAST_X]), scale * (way.y - state[LAST_Y])
    state[LAST_X], state[LAST_Y] = way.x, way.y
    if way.weight != 0.0:
        du, dv = du + way.weight * (way.wheel_x - du), dv + way.weight * (way.wheel_y - dv)
    ax, ay, az = world[ALONG_X], world[ALONG_X + 1], world[ALONG_X + 2]
    bx, by, bz = world[ALONG_Y], world[ALONG_Y + 1], world[ALONG_Y + 2]
    dx, dy, dz = ax * du + bx * dv, ay * du + by * dv, az * du + bz * dv
    c, s = math.cos(state[YAW]), math.sin(state[YAW])
    walk = errors[POSITION_WALK] * math.sqrt(way.speed) * root
    px = state[POSITION] + c * dx - s * dy + walk * noise[1]
    py = state[POSITION + 1] + s * dx + c * dy + walk * noise[2]
    pz = state[POSITION + 2] + dz + walk * noise[3]
    state[POSITION], state[POSITION + 1], state[POSITION + 2] = px, py, pz
    sp, sv, sw = errors[POSITION_NOISE], errors[VELOCITY_NOISE], errors[RATE_NOISE]
    qx, qy, qz, qw = rotation(way.theta, state[YAW], noise, errors, world)
    return (  # each vector in the camera's axes: (-y, z, -x) of the robot's
        -(py + sp * noise[5]),
        pz + sp * noise[6],
        -(px + sp * noise[4]),
        -(ay * along + by * left + sv * noise[8]),
        az * along + bz * left + sv * noise[9],
        -(ax * along + bx * left + sv * noise[7]),
        -qy,
        qz,
        -qx,
        qw,
        -(world[ALONG_Z + 1] * omega + sw * noise[11]),
        world[ALONG_Z + 2] * omega + sw * noise[12],
        -(world[ALONG_Z] * omega + sw * noise[10]),
    )


@inner
def rotation(
    theta: float, yaw: float, noise: Array, errors: Array, world: Array
) -> tuple[float, float, float, float]:
    """Camera in the levelled world (x, y, z, w): heading error and noise on the left."""
    c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
    bw = c * world[COSINE_PART] + s * world[SINE_PART]
    bx = c * world[COSINE_PART + 1] + s * world[SINE_PART + 1]
    by = c * world[COSINE_PART + 2] + s * world[SINE_PART + 2]
    bz = c * world[COSINE_PART + 3] + s * world[SINE_PART + 3]
    half = 0.5 * errors[ANGLE_NOISE]
    ex, ey = half * noise[13], half * noise[14]
    turned = 0.5 * yaw + half * noise[15]
    ew, ez = math.cos(turned), math.sin(turned)
    w = ew * bw - ex * bx - ey * by - ez * bz
    x = ew * bx + ex * bw + ey * bz - ez * by
    y = ew * by - ex * bz + ey * bw + ez * bx
    z = ew * bz + ex * by - ey * bx + ez * bw
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return x / norm, y / norm, z / norm, w / norm
