"""Measurement models, once for every engine: what a sample says, what the state predicts, the derivative.

* Wheels: displacement of the body since the last servo read, cloned pose to present pose, as eight scalar
  equations u_i = (P d)_i or as one body displacement. With d = (d_x, d_y, turn) in the frame half-way:
  rolled = d_xy - R' (s dt + c rho), turned = turn - kappa rho, both times (1 + scale) where the wheel
  scale is free; rho is the mean displacement of the wheels at
  their speed of the last half second: with the step's own displacement its errors would correlate with
  the row and be taken for slip.
* Gyro: omega + bias, and on the wall theta + offset from gravity.
* Camera: pose in its own, cloned and drifting frame: (1 + scale) R(theta_f)' (p - p_f), theta - theta_f.
* Motion capture: the pose.

`auxiliary` is (dt_s, rho_m).
"""

from __future__ import annotations

import math

import numpy as np

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.friction import windowed_twist
from hil.estimator.process import sinc, sinc_slope
from hil.vocabulary.geometry import Array

QUALITY_FACTOR = 4.0
ROLLING_S = 0.5


@compiled
def observe(
    kind: int, t_ns: float, m: Array, data: Array, par: Array, wheels: Array, rows: Array,
    z: Array, var: Array, aux: Array,
) -> int:  # fmt: skip
    """Turn one sample into rows: measured z, variance var (negative: row not usable), auxiliary figures.

    Args:
        kind: sensor id of `layout`.
        t_ns: stamp since the start.
        m: sensor memory (72,) before the sample; its rolling speed and friction window take the new step.
        data: event row (16,).
        par: `layout.parameters`.
        wheels: (6, 4), and
        rows: (8, 11), of `layout.wheel_tables`.
        z: (8,) filled with what was measured.
        var: (8,) filled with its variances.
        aux: (2,) filled with the auxiliary figures.

    Returns:
        Number of rows; 0 when there is nothing to compare with.
    """
    if kind == L.WHEELS:
        return observe_wheels(t_ns, m, data, par, wheels, rows, z, var, aux)
    if kind == L.GYRO:
        z[0], z[1] = data[0], data[1]
        var[0] = par[L.RATE_RAD_S] if math.isfinite(data[0]) else -1.0
        pull = data[2] * data[2] + data[3] * data[3]
        known = par[L.GRAVITY_ON] > 0.0 and math.isfinite(data[1])
        var[1] = par[L.GRAVITY_RAD] + par[L.GRAVITY_A] * pull if known else -1.0
        return 2
    for i in range(3):
        z[i] = data[i]
    if kind == L.TRACKER:
        factor = QUALITY_FACTOR if data[3] < 3.0 else 1.0
        var[0] = var[1] = par[L.TRACKER_M] * factor
        var[2] = par[L.TRACKER_RAD] * factor
    else:
        var[0] = var[1] = par[L.MOCAP_M]
        var[2] = par[L.MOCAP_RAD]
    return 3


@compiled
def observe_wheels(
    t_ns: float, m: Array, data: Array, par: Array, wheels: Array, rows: Array,
    z: Array, var: Array, aux: Array,
) -> int:  # fmt: skip
    """Wheel displacements since the last read as eight or three rows; see `observe`."""
    dt = (t_ns - m[L.WHEEL_T]) * 1e-9
    if m[L.WHEEL_T] < 0.0 or dt > par[L.GAP_S]:
        return 0
    u, noise = np.zeros(8), np.full(8, -1.0)
    rolled, count = 0.0, 0
    for i in range(4):
        angle = data[8 + i] * dt if par[L.FROM_RATE] > 0.0 else data[i] - m[L.WHEEL_ANGLE + i]
        turned = data[4 + i] - m[L.WHEEL_STEER + i]
        if not (math.isfinite(angle) and math.isfinite(turned)):
            continue
        length = angle * wheels[0, i]
        heading = 0.5 * (data[4 + i] + m[L.WHEEL_STEER + i]) - wheels[1, i]
        u[2 * i], u[2 * i + 1] = length * math.cos(heading), length * math.sin(heading)
        spread = par[L.STEP_M] + par[L.PER_M] * abs(length) + par[L.PER_S] * dt
        noise[2 * i] = noise[2 * i + 1] = spread + par[L.STEERING_M] * turned * turned
        rolled += abs(length)
        count += 1
    if count == 0:
        return 0
    m[L.ROLLING] += (1.0 - math.exp(-dt / ROLLING_S)) * (rolled / (count * dt) - m[L.ROLLING])
    aux[0], aux[1] = dt, m[L.ROLLING] * dt
    if par[L.WHEEL_ROWS] > 3.0:
        z[:] = u
        var[:] = noise
        return 8
    return body_rows(u, noise, count, dt, m, wheels, rows, par, z, var)


@compiled
def body_rows(
    u: Array, noise: Array, count: int, dt: float, m: Array, wheels: Array, rows: Array, par: Array,
    z: Array, var: Array,
) -> int:  # fmt: skip
    """One body displacement of all four wheels; nothing when a wheel is missing."""
    if count < 4:
        return 0
    if par[L.FRICTION_S] > 0.0:
        decay = math.exp(-dt / par[L.FRICTION_S])
        b = windowed_twist(u, m[L.WINDOW : L.WINDOW + 8], decay, wheels, par[L.CREEP] > 0.0)
        for j in range(3):
            z[j] = b[j]
    for j in range(3):
        total, spread = 0.0, 0.0
        for i in range(8):
            f = rows[j, 3 + i]
            total += f * u[i]
            spread += f * f * noise[i]
        if par[L.FRICTION_S] <= 0.0:
            z[j] = total
        var[j] = spread
    return 3


@compiled
def predicted(kind: int, x: Array, aux: Array, par: Array, rows: Array, out: Array) -> None:
    """Rows (8,) that the state predicts for a sample of this kind."""
    if kind == L.WHEELS:
        mid, h = 0.5 * (x[2] + x[19]), 0.5 * (x[2] - x[19])
        g = 1.0 / sinc(h)
        c, s = math.cos(mid), math.sin(mid)
        qx = g * (x[0] - x[17]) - x[8] * aux[0] - x[10] * aux[1]
        qy = g * (x[1] - x[18]) - x[9] * aux[0] - x[11] * aux[1]
        size = 1.0 + par[L.WHEELS_SCALED] * x[12]
        dx, dy = size * (c * qx + s * qy), size * (c * qy - s * qx)
        turn = size * (2.0 * h - x[7] * aux[1])
        for j in range(int(par[L.WHEEL_ROWS])):
            out[j] = rows[j, 0] * dx + rows[j, 1] * dy + rows[j, 2] * turn
    elif kind == L.GYRO:
        out[0] = x[5] + x[6]
        out[1] = x[2] + x[13]
    elif kind == L.TRACKER:
        c, s = math.cos(x[16]), math.sin(x[16])
        dx, dy = x[0] - x[14], x[1] - x[15]
        size = 1.0 + par[L.CAMERA_SCALED] * x[12]
        out[0] = size * (c * dx + s * dy)
        out[1] = size * (c * dy - s * dx)
        out[2] = x[2] - x[16]
    else:
        out[0], out[1], out[2] = x[0], x[1], x[2]


@compiled
def jacobian(kind: int, x: Array, aux: Array, par: Array, rows: Array, h: Array) -> None:
    """Derivative (8, 20) of `predicted` by the state, into a zeroed array."""
    if kind == L.WHEELS:
        _wheel_jacobian(x, aux, par, rows, h)
    elif kind == L.GYRO:
        h[0, 5] = h[0, 6] = 1.0
        h[1, 2] = h[1, 13] = 1.0
    elif kind == L.TRACKER:
        c, s = math.cos(x[16]), math.sin(x[16])
        dx, dy = x[0] - x[14], x[1] - x[15]
        size = 1.0 + par[L.CAMERA_SCALED] * x[12]
        ahead, left = c * dx + s * dy, c * dy - s * dx
        h[0, 0], h[0, 1], h[1, 0], h[1, 1] = size * c, size * s, -size * s, size * c
        h[0, 14], h[0, 15], h[1, 14], h[1, 15] = -size * c, -size * s, size * s, -size * c
        h[0, 16], h[1, 16] = size * left, -size * ahead
        h[0, 12], h[1, 12] = par[L.CAMERA_SCALED] * ahead, par[L.CAMERA_SCALED] * left
        h[2, 2], h[2, 16] = 1.0, -1.0
    else:
        h[0, 0] = h[1, 1] = h[2, 2] = 1.0


@compiled
def _wheel_jacobian(x: Array, aux: Array, par: Array, rows: Array, out: Array) -> None:
    mid, h = 0.5 * (x[2] + x[19]), 0.5 * (x[2] - x[19])
    k = sinc(h)
    g, bend = 1.0 / k, -sinc_slope(h) / (k * k)
    c, s = math.cos(mid), math.sin(mid)
    px, py = x[0] - x[17], x[1] - x[18]
    qx = g * px - x[8] * aux[0] - x[10] * aux[1]
    qy = g * py - x[9] * aux[0] - x[11] * aux[1]
    ahead, left = c * qx + s * qy, c * qy - s * qx
    bend_x, bend_y = bend * (c * px + s * py), bend * (c * py - s * px)
    size = 1.0 + par[L.WHEELS_SCALED] * x[12]
    d = np.zeros((3, L.STATES))
    d[0, 0], d[0, 1], d[1, 0], d[1, 1] = g * c, g * s, -g * s, g * c
    d[0, 2], d[0, 19] = 0.5 * (left + bend_x), 0.5 * (left - bend_x)
    d[1, 2], d[1, 19] = 0.5 * (-ahead + bend_y), 0.5 * (-ahead - bend_y)
    d[2, 2], d[2, 19], d[2, 7] = 1.0, -1.0, -aux[1]
    for j in range(2):
        d[j, 17], d[j, 18] = -d[j, 0], -d[j, 1]
        for i in range(2):
            axis = d[j, i] / g
            d[j, 8 + i], d[j, 10 + i] = -axis * aux[0], -axis * aux[1]
    for i in range(L.STATES):
        d[0, i] *= size
        d[1, i] *= size
        d[2, i] *= size
    if par[L.WHEELS_SCALED] > 0.0:
        d[0, 12], d[1, 12], d[2, 12] = ahead, left, 2.0 * h - x[7] * aux[1]
    for j in range(int(par[L.WHEEL_ROWS])):
        for i in range(L.STATES):
            out[j, i] = rows[j, 0] * d[0, i] + rows[j, 1] * d[1, i] + rows[j, 2] * d[2, i]
