"""Motion of the state under a constant body twist, and its derivatives.

One twist moves two poses: the one in the wall frame and the one in the camera's own frame. The latter moves
(1 + scale) times as far. The derivative by the scale is taken at the velocity that the wheels measure
(`nominal`, (2,), m/s, body frame), not at the estimated velocity. The estimate contains the noise of the same
camera samples that the next sample is compared with; with it the scale would drift whatever the truth
(docs/decisions/0024). The mean uses the estimated velocity.
"""

import math
from typing import TypeAlias

import numpy as np

from hil.core.geometry import Array
from hil.estimator.state_vector import (
    CAMERA_THETA,
    CAMERA_X,
    CAMERA_Y,
    OMEGA,
    SCALE,
    SLIP_X,
    SLIP_Y,
    STATES,
    THETA,
    V_X,
    V_Y,
    X,
    Y,
)
from hil.support.numba_jit import inner

Slopes: TypeAlias = tuple[float, float, float, float]
"""Derivatives of a displacement by heading, speed ahead, speed to the left and yaw rate."""


@inner
def sinc(h: float) -> float:
    """sin(h) / h."""
    if abs(h) < 1e-3:
        return 1.0 - h * h / 6.0 + h * h * h * h / 120.0
    return math.sin(h) / h


@inner
def sinc_slope(h: float) -> float:
    """Derivative of sin(h) / h; the series is used where the closed form cancels."""
    if abs(h) < 1e-2:
        return -h / 3.0 + h * h * h / 30.0 - h * h * h * h * h / 840.0
    return (math.cos(h) - math.sin(h) / h) / h


@inner
def shift(theta: float, ahead: float, left: float, omega: float, dt_s: float) -> tuple[float, float]:
    """Displacement at heading `theta` by a body twist (ahead, left, omega) over `dt_s`."""
    h = 0.5 * omega * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(theta + h), math.sin(theta + h)
    return k * (c * ahead - s * left), k * (s * ahead + c * left)


@inner
def shift_slopes(theta: float, ahead: float, left: float, omega: float, dt_s: float) -> tuple[Slopes, Slopes]:
    """Derivatives of both components of `shift` by heading and twist."""
    h = 0.5 * omega * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(theta + h), math.sin(theta + h)
    east, north = c * ahead - s * left, s * ahead + c * left
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    return (
        (-k * north, k * c, -k * s, slope * east - 0.5 * dt_s * k * north),
        (k * east, k * s, k * c, slope * north + 0.5 * dt_s * k * east),
    )


@inner
def times(size: float, a: Slopes) -> Slopes:
    """Multiply all four derivatives by `size`."""
    return size * a[0], size * a[1], size * a[2], size * a[3]


@inner
def wall_shift(x: Array, dt_s: float) -> tuple[float, float]:
    """Displacement of the pose in the wall frame, for a state (20,)."""
    return shift(x[THETA], x[V_X], x[V_Y], x[OMEGA], dt_s)


@inner
def camera_displacement(
    x: Array, dt_s: float, scaled: float, scale: float, nominal: Array
) -> tuple[float, float]:
    """Displacement of the pose in the camera's frame, for x (20,).

    `scale` is the mean's scale error. The part by which a sigma point differs from it acts on `nominal` (2,).
    """
    east, north = shift(x[CAMERA_THETA], x[V_X], x[V_Y], x[OMEGA], dt_s)
    far_east, far_north = shift(x[CAMERA_THETA], nominal[0], nominal[1], x[OMEGA], dt_s)
    size, more = 1.0 + scaled * scale, scaled * (x[SCALE] - scale)
    return size * east + more * far_east, size * north + more * far_north


@inner
def advance_linear_states(x: Array, dt_s: float, decay: float) -> None:
    """Advance the linear part of the state (20,) by `dt_s`: both headings and the slip velocity; in place."""
    x[THETA] += x[OMEGA] * dt_s
    x[CAMERA_THETA] += x[OMEGA] * dt_s
    x[SLIP_X] *= decay
    x[SLIP_Y] *= decay


@inner
def apply_displacements(
    x: Array, wall: tuple[float, float], sight: tuple[float, float], dt_s: float, decay: float
) -> None:
    """Add the displacements to both poses of the state (20,), then advance its linear part; in place."""
    x[X] += wall[0]
    x[Y] += wall[1]
    x[CAMERA_X] += sight[0]
    x[CAMERA_Y] += sight[1]
    advance_linear_states(x, dt_s, decay)


@inner
def move(x: Array, dt_s: float, slip_s: float, scaled: float, scale: float, nominal: Array) -> None:
    """Advance the state (20,) by `dt_s`, in place: SE(2) exponential of the twist, decay of the slip."""
    wall, sight = wall_shift(x, dt_s), camera_displacement(x, dt_s, scaled, scale, nominal)
    apply_displacements(x, wall, sight, dt_s, math.exp(-dt_s / slip_s))


@inner
def slopes(
    x: Array, dt_s: float, scaled: float, nominal: Array
) -> tuple[Slopes, Slopes, Slopes, Slopes, tuple[float, float]]:
    """Derivatives of the displacements of x (20,) by heading and twist, and of the camera's by the scale.

    Returns wall x, wall y, camera x, camera y, and camera (x, y) by the scale; `nominal` (2,).
    """
    a, b = shift_slopes(x[THETA], x[V_X], x[V_Y], x[OMEGA], dt_s)
    c, d = shift_slopes(x[CAMERA_THETA], x[V_X], x[V_Y], x[OMEGA], dt_s)
    far = shift(x[CAMERA_THETA], scaled * nominal[0], scaled * nominal[1], x[OMEGA], dt_s)
    size = 1.0 + scaled * x[SCALE]
    return a, b, times(size, c), times(size, d), far


@inner
def transition(x: Array, dt_s: float, slip_s: float, scaled: float, nominal: Array) -> Array:
    """Derivative (20, 20) of `move` by the state: the transition matrix F."""
    f = np.eye(STATES)
    a, b, c, d, far = slopes(x, dt_s, scaled, nominal)
    f[X, THETA], f[X, V_X], f[X, V_Y], f[X, OMEGA] = a
    f[Y, THETA], f[Y, V_X], f[Y, V_Y], f[Y, OMEGA] = b
    f[CAMERA_X, CAMERA_THETA], f[CAMERA_X, V_X], f[CAMERA_X, V_Y], f[CAMERA_X, OMEGA] = c
    f[CAMERA_Y, CAMERA_THETA], f[CAMERA_Y, V_X], f[CAMERA_Y, V_Y], f[CAMERA_Y, OMEGA] = d
    f[CAMERA_X, SCALE], f[CAMERA_Y, SCALE] = far
    f[THETA, OMEGA] = f[CAMERA_THETA, OMEGA] = dt_s
    f[SLIP_X, SLIP_X] = f[SLIP_Y, SLIP_Y] = math.exp(-dt_s / slip_s)
    return f
