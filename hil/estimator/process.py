"""Process model: constant body twist on SE(2) with random accelerations, and slowly changing nuisances.

One twist moves two poses: that in the wall frame, and that in the camera's own frame, (1 + scale) as far.
The derivative by the scale is taken at what the wheels say of the velocity (`nominal`, (2,), m/s, body
frame), not at the estimate: this carries the noise of the very camera samples that the next one is compared
with, and with it the scale would drift whatever the truth (docs/decisions/0024). In the mean the estimate
counts.
"""

from __future__ import annotations

import math

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator.records import Record
from hil.estimator.state import (
    BIAS,
    CREEP_X,
    CREEP_Y,
    OMEGA,
    SCALE,
    SIGHT_THETA,
    SIGHT_X,
    SIGHT_Y,
    SLIP_X,
    SLIP_Y,
    STATES,
    THETA,
    V_X,
    V_Y,
    YAW_SLIP,
    X,
)
from hil.vocabulary.geometry import Array
from hil.vocabulary.kernels import compiled


class ProcessParameters(Record):
    """Noise of the process: variance per second, per rolled metre, or (slip) in the long run.

    Attributes:
        acceleration, angular_acceleration: power densities, m^2/s^3 and rad^2/s^3.
        slip_x, slip_y: stationary variance of the slip velocity, m^2/s^2; `slip_s` is its time constant.
        creep_x, creep_y: of the slip per rolled metre, 1/m.
        yaw_slip: of the turn per rolled metre, rad^2/m^3.
        bias: of the gyro bias, rad^2/s^3.
        sight_per_m, sight_per_s, sight_turn: drift of the camera, m^2/m, m^2/s and rad^2/s.
        scaled: 1 where the state's scale error is that of the camera, else 0.
    """

    acceleration: float
    angular_acceleration: float
    slip_x: float
    slip_y: float
    slip_s: float
    creep_x: float
    creep_y: float
    yaw_slip: float
    bias: float
    sight_per_m: float
    sight_per_s: float
    sight_turn: float
    scaled: float


def process_values(config: EstimatorConfig, surface: str) -> dict[str, float]:
    """Values of `ProcessParameters`."""
    slip, camera, noise = config.wall if surface == "wall" else config.floor, config.tracker, config.process
    drifts = camera.use == "relative"
    walk_x, walk_y = (
        slip.creep_per_sqrt_m * (part / slip.creep if slip.creep > 0 else 0.0)
        for part in (slip.creep, slip.creep_across)
    )
    return {
        "acceleration": noise.acceleration_m_s2_sqrt_hz**2,
        "angular_acceleration": noise.angular_acceleration_rad_s2_sqrt_hz**2,
        "slip_x": slip.slip_m_s**2, "slip_y": slip.slip_across_m_s**2, "slip_s": slip.slip_time_s,
        "creep_x": walk_x**2, "creep_y": walk_y**2, "yaw_slip": slip.yaw_per_sqrt_m**2,
        "bias": config.gyro.bias_rad_s_sqrt_s**2,
        "sight_per_m": camera.drift_per_sqrt_m**2 * drifts,
        "sight_per_s": camera.drift_per_sqrt_s**2 * drifts,
        "sight_turn": camera.yaw_drift_per_sqrt_s**2 * drifts, "scaled": camera.scale_sigma > 0,
    }  # fmt: skip


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
def shift(theta: float, ahead: float, left: float, omega: float, dt_s: float, out: Array) -> None:
    """Displacement (2,) at heading `theta` by a body twist (ahead, left, omega) in `dt_s`."""
    h = 0.5 * omega * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(theta + h), math.sin(theta + h)
    out[0], out[1] = k * (c * ahead - s * left), k * (s * ahead + c * left)


@compiled
def shift_slopes(theta: float, ahead: float, left: float, omega: float, dt_s: float, out: Array) -> None:
    """Derivative (2, 4) of `shift` by heading and twist."""
    h = 0.5 * omega * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(theta + h), math.sin(theta + h)
    east, north = c * ahead - s * left, s * ahead + c * left
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    out[0, 0], out[0, 1], out[0, 2] = -k * north, k * c, -k * s
    out[1, 0], out[1, 1], out[1, 2] = k * east, k * s, k * c
    out[0, 3] = slope * east - 0.5 * dt_s * k * north
    out[1, 3] = slope * north + 0.5 * dt_s * k * east


@compiled
def shifts(x: Array, dt_s: float, scaled: float, scale: float, nominal: Array, out: Array) -> None:
    """Displacements (4,) of a state's two poses; `scale` is that of the mean; points differ."""
    wall, sight, longer = np.zeros(2), np.zeros(2), np.zeros(2)
    shift(x[THETA], x[V_X], x[V_Y], x[OMEGA], dt_s, wall)
    shift(x[SIGHT_THETA], x[V_X], x[V_Y], x[OMEGA], dt_s, sight)
    shift(x[SIGHT_THETA], nominal[0], nominal[1], x[OMEGA], dt_s, longer)
    size, more = 1.0 + scaled * scale, scaled * (x[SCALE] - scale)
    for i in range(2):
        out[i], out[2 + i] = wall[i], size * sight[i] + more * longer[i]


@compiled
def fade(x: Array, dt_s: float, slip_s: float) -> None:
    """Headings and slip velocity of the state (20,) after `dt_s`: what moves linearly."""
    x[THETA] += x[OMEGA] * dt_s
    x[SIGHT_THETA] += x[OMEGA] * dt_s
    decay = math.exp(-dt_s / slip_s)
    x[SLIP_X] *= decay
    x[SLIP_Y] *= decay


@compiled
def move(x: Array, dt_s: float, slip_s: float, scaled: float, scale: float, nominal: Array) -> None:
    """State (20,) after `dt_s`: SE(2) exponential of the body twist, decay of the slip velocity."""
    moved = np.zeros(4)
    shifts(x, dt_s, scaled, scale, nominal, moved)
    for i in range(2):
        x[X + i] += moved[i]
        x[SIGHT_X + i] += moved[2 + i]
    fade(x, dt_s, slip_s)


@compiled
def slopes(
    x: Array, dt_s: float, scaled: float, nominal: Array, wall: Array, sight: Array, longer: Array
) -> None:
    """Derivatives of both displacements by heading and twist (2, 4), and of the second by the scale (2,)."""
    shift_slopes(x[THETA], x[V_X], x[V_Y], x[OMEGA], dt_s, wall)
    shift_slopes(x[SIGHT_THETA], x[V_X], x[V_Y], x[OMEGA], dt_s, sight)
    sight *= 1.0 + scaled * x[SCALE]
    shift(x[SIGHT_THETA], scaled * nominal[0], scaled * nominal[1], x[OMEGA], dt_s, longer)


@compiled
def transition(x: Array, dt_s: float, slip_s: float, scaled: float, nominal: Array) -> Array:
    """Derivative (20, 20) of `move` by the state."""
    f = np.eye(STATES)
    wall, sight, longer = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros(2)
    slopes(x, dt_s, scaled, nominal, wall, sight, longer)
    for i in range(2):
        f[X + i, THETA], f[SIGHT_X + i, SIGHT_THETA] = wall[i, 0], sight[i, 0]
        for j in range(3):
            f[X + i, V_X + j], f[SIGHT_X + i, V_X + j] = wall[i, 1 + j], sight[i, 1 + j]
        f[SIGHT_X + i, SCALE] = longer[i]
    f[THETA, OMEGA] = f[SIGHT_THETA, OMEGA] = dt_s
    f[SLIP_X, SLIP_X] = f[SLIP_Y, SLIP_Y] = math.exp(-dt_s / slip_s)
    return f


@compiled
def _add_motion(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Noise of the twist in both poses: what moves them is one and the same."""
    q, turn = par.acceleration, par.angular_acceleration
    half, third = 0.5 * dt_s * dt_s, dt_s * dt_s * dt_s / 3.0
    size = 1.0 + par.scaled * x[SCALE]
    p[V_X, V_X] += q * dt_s
    p[V_Y, V_Y] += q * dt_s
    p[OMEGA, OMEGA] += turn * dt_s
    for place, theta, scale in ((X, THETA, 1.0), (SIGHT_X, SIGHT_THETA, size)):
        c, s = scale * math.cos(x[theta]), scale * math.sin(x[theta])
        p[place, place] += scale * scale * q * third
        p[place + 1, place + 1] += scale * scale * q * third
        p[theta, theta] += turn * third
        p[theta, OMEGA] += turn * half
        p[OMEGA, theta] += turn * half
        for i, j, value in ((0, V_X, c), (1, V_X, s), (0, V_Y, -s), (1, V_Y, c)):
            p[place + i, j] += value * q * half
            p[j, place + i] += value * q * half
    between = x[SIGHT_THETA] - x[THETA]
    c, s = size * q * third * math.cos(between), size * q * third * math.sin(between)
    for i, j, value in ((0, 0, c), (0, 1, s), (1, 0, -s), (1, 1, c)):
        p[X + i, SIGHT_X + j] += value
        p[SIGHT_X + j, X + i] += value
    p[THETA, SIGHT_THETA] += turn * third
    p[SIGHT_THETA, THETA] += turn * third


@compiled
def add_noise(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Add the process noise of a step that began at state x (20,) to p (20, 20), exact in its length."""
    rolled = math.sqrt(x[V_X] * x[V_X] + x[V_Y] * x[V_Y]) * dt_s
    _add_motion(x, p, dt_s, par)
    p[BIAS, BIAS] += par.bias * dt_s
    p[YAW_SLIP, YAW_SLIP] += par.yaw_slip * rolled
    renewed = 1.0 - math.exp(-2.0 * dt_s / par.slip_s)
    p[SLIP_X, SLIP_X] += par.slip_x * renewed
    p[SLIP_Y, SLIP_Y] += par.slip_y * renewed
    p[CREEP_X, CREEP_X] += par.creep_x * rolled
    p[CREEP_Y, CREEP_Y] += par.creep_y * rolled
    drift = par.sight_per_m * rolled + par.sight_per_s * dt_s
    p[SIGHT_X, SIGHT_X] += drift
    p[SIGHT_Y, SIGHT_Y] += drift
    p[SIGHT_THETA, SIGHT_THETA] += par.sight_turn * dt_s


@compiled
def advance_linear(x: Array, p: Array, dt_s: float, par: ProcessParameters, nominal: Array) -> None:
    """Extended Kalman prediction of x (20,), p (20, 20), in place; F P F' only for rows that change."""
    wall, sight, longer = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros(2)
    slopes(x, dt_s, par.scaled, nominal, wall, sight, longer)
    decay = math.exp(-dt_s / par.slip_s)
    for _ in range(2):
        for j in range(STATES):
            turned, seen, ahead, left = p[THETA, j], p[SIGHT_THETA, j], p[V_X, j], p[V_Y, j]
            spun, scale = p[OMEGA, j], p[SCALE, j]
            for i in range(2):
                a, b = wall[i], sight[i]
                p[X + i, j] += a[0] * turned + a[1] * ahead + a[2] * left + a[3] * spun
                p[SIGHT_X + i, j] += (
                    b[0] * seen + b[1] * ahead + b[2] * left + b[3] * spun + longer[i] * scale
                )
            p[THETA, j] += dt_s * spun
            p[SIGHT_THETA, j] += dt_s * spun
            p[SLIP_X, j] *= decay
            p[SLIP_Y, j] *= decay
        for i in range(STATES):
            for j in range(i):
                p[i, j], p[j, i] = p[j, i], p[i, j]
    for i in range(STATES):
        for j in range(i):
            p[i, j] = p[j, i]
    add_noise(x, p, dt_s, par)
    move(x, dt_s, par.slip_s, par.scaled, x[SCALE], nominal)
