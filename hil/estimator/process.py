"""Process model: constant body twist on SE(2) with random accelerations, and slowly changing nuisances.

Every kernel works in place on one state (20,) and covariance (20, 20), layout in `hil.estimator.layout`.
"""

from __future__ import annotations

import math

import numpy as np

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.vocabulary.geometry import Array


@compiled
def sinc(h: float) -> float:
    """sin(h) / h."""
    if abs(h) < 1e-3:
        return 1.0 - h * h / 6.0 + h * h * h * h / 120.0
    return math.sin(h) / h


@compiled
def sinc_slope(h: float) -> float:
    """Derivative of sin(h) / h; the series is used where the closed form cancels."""
    if abs(h) < 1e-2:
        return -h / 3.0 + h * h * h / 30.0 - h * h * h * h * h / 840.0
    return (math.cos(h) - math.sin(h) / h) / h


@compiled
def move(x: Array, dt_s: float, slip_s: float) -> None:
    """State (20,) after `dt_s`: SE(2) exponential of the body twist, decay of the slip velocity."""
    h = 0.5 * x[5] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[2] + h), math.sin(x[2] + h)
    x[0] += k * (c * x[3] - s * x[4])
    x[1] += k * (s * x[3] + c * x[4])
    x[2] += x[5] * dt_s
    decay = math.exp(-dt_s / slip_s)
    x[8] *= decay
    x[9] *= decay


@compiled
def transition(x: Array, dt_s: float, slip_s: float) -> Array:
    """Derivative (20, 20) of `move` by the state."""
    f = np.eye(L.STATES)
    h = 0.5 * x[5] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[2] + h), math.sin(x[2] + h)
    ahead, left = c * x[3] - s * x[4], s * x[3] + c * x[4]
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    f[0, 2], f[1, 2] = -k * left, k * ahead
    f[0, 3], f[0, 4] = k * c, -k * s
    f[1, 3], f[1, 4] = k * s, k * c
    f[0, 5] = slope * ahead - 0.5 * dt_s * k * left
    f[1, 5] = slope * left + 0.5 * dt_s * k * ahead
    f[2, 5] = dt_s
    f[8, 8] = f[9, 9] = math.exp(-dt_s / slip_s)
    return f


@compiled
def add_noise(x: Array, p: Array, dt_s: float, par: Array) -> None:
    """Add the process noise of a step that began at state x, with exact powers of its length."""
    speed = math.sqrt(x[3] * x[3] + x[4] * x[4])
    rolled = speed * dt_s
    c, s = math.cos(x[2]), math.sin(x[2])
    q, turn = par[L.Q_SPEED], par[L.Q_TURN]
    half, third = 0.5 * dt_s * dt_s, dt_s * dt_s * dt_s / 3.0
    p[0, 0] += q * third
    p[1, 1] += q * third
    p[2, 2] += turn * third
    p[3, 3] += q * dt_s
    p[4, 4] += q * dt_s
    p[5, 5] += turn * dt_s
    for i, j, value in ((0, 3, c), (1, 3, s), (0, 4, -s), (1, 4, c)):
        p[i, j] += value * q * half
        p[j, i] += value * q * half
    p[2, 5] += turn * half
    p[5, 2] += turn * half
    p[6, 6] += par[L.BIAS_WALK] * dt_s
    p[7, 7] += par[L.YAW_WALK] * rolled
    renewed = 1.0 - math.exp(-2.0 * dt_s / par[L.SLIP_S])
    p[8, 8] += par[L.SLIP_M_S] * renewed
    p[9, 9] += par[L.SLIP_ACROSS_M_S] * renewed
    p[10, 10] += par[L.CREEP_WALK] * rolled
    p[11, 11] += par[L.CREEP_WALK_ACROSS] * rolled
    _drift(x, p, dt_s, rolled, par)


@compiled
def _drift(x: Array, p: Array, dt_s: float, rolled: float, par: Array) -> None:
    """Drift of the camera's frame: it shifts, and it turns about the robot, not about its own origin."""
    shift = par[L.DRIFT_M] * rolled + par[L.DRIFT_S] * dt_s
    p[14, 14] += shift
    p[15, 15] += shift
    q = par[L.YAW_DRIFT] * dt_s
    gx, gy = x[1] - x[15], x[14] - x[0]
    p[14, 14] += q * gx * gx
    p[15, 15] += q * gy * gy
    p[16, 16] += q
    p[14, 15] += q * gx * gy
    p[15, 14] += q * gx * gy
    p[14, 16] += q * gx
    p[16, 14] += q * gx
    p[15, 16] += q * gy
    p[16, 15] += q * gy


@compiled
def advance_linear(x: Array, p: Array, dt_s: float, par: Array) -> None:
    """Extended Kalman prediction, in place; the product F P F' is written out for the rows that change."""
    h = 0.5 * x[5] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[2] + h), math.sin(x[2] + h)
    ahead, left = c * x[3] - s * x[4], s * x[3] + c * x[4]
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    ax, bx, cx = -k * left, k * c, -k * s
    ay, by, cy = k * ahead, k * s, k * c
    wx, wy = slope * ahead - 0.5 * dt_s * k * left, slope * left + 0.5 * dt_s * k * ahead
    decay = math.exp(-dt_s / par[L.SLIP_S])
    for _ in range(2):
        for i in range(L.STATES):
            p[0, i] += ax * p[2, i] + bx * p[3, i] + cx * p[4, i] + wx * p[5, i]
            p[1, i] += ay * p[2, i] + by * p[3, i] + cy * p[4, i] + wy * p[5, i]
            p[2, i] += dt_s * p[5, i]
            p[8, i] *= decay
            p[9, i] *= decay
        for i in range(L.STATES):
            for j in range(i):
                p[i, j], p[j, i] = p[j, i], p[i, j]
    for i in range(L.STATES):
        for j in range(i):
            p[i, j] = p[j, i]
    add_noise(x, p, dt_s, par)
    move(x, dt_s, par[L.SLIP_S])


@compiled
def copy_pose(x: Array, p: Array, at: int) -> None:
    """Clone the pose and its correlations into the three states from `at`."""
    for i in range(3):
        x[at + i] = x[i]
        p[at + i, :] = p[i, :]
    for i in range(3):
        p[:, at + i] = p[:, i]


@compiled
def anchor_matrix(rx: float, ry: float, size: float, scaled: float) -> Array:
    """Derivative (20, 20) of the anchored state by the one before; r: from the frame to the body."""
    a = np.eye(L.STATES)
    a[14, :] = 0.0
    a[15, :] = 0.0
    a[16, :] = 0.0
    a[14, 0] = a[15, 1] = a[16, 2] = 1.0
    a[14, 2], a[15, 2] = ry, -rx
    a[14, 12], a[15, 12] = scaled * rx / size, scaled * ry / size
    return a


@compiled
def anchor_frame(x: Array, p: Array, z: Array, var_m: float, var_rad: float, scaled: float) -> None:
    """Clone the camera's frame so that the pose z (3,) is what it shows now, and spread its uncertainty.

    theta_f = theta - z_theta; p_f = p - R(theta_f) z / (1 + scale). Source: the measurement's inverse.
    """
    n = L.STATES
    heading = x[2] - z[2]
    size = 1.0 + scaled * x[12]
    c, s = math.cos(heading), math.sin(heading)
    rx, ry = (c * z[0] - s * z[1]) / size, (s * z[0] + c * z[1]) / size
    a = anchor_matrix(rx, ry, size, scaled)
    p[:, :] = a @ p @ a.T
    x[14], x[15], x[16] = x[0] - rx, x[1] - ry, heading
    b = np.zeros((3, 3))
    b[0, 2], b[1, 2], b[2, 2] = -ry, rx, -1.0
    b[0, 0] = b[1, 1] = 1.0 / size
    for i in range(3):
        for j in range(3):
            p[14 + i, 14 + j] += b[i, 2] * b[j, 2] * var_rad
            if i == j and i < 2:
                p[14 + i, 14 + j] += var_m / (size * size)
    for i in range(n):
        for j in range(i):
            p[i, j] = p[j, i]
