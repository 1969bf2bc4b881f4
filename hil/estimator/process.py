"""Process model: constant body twist on SE(2) with random accelerations, and slowly changing nuisances.

Every kernel works in place on one state (20,) and covariance (20, 20), their order in `hil.estimator.state`.
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
    FRAME_THETA,
    FRAME_X,
    FRAME_Y,
    OMEGA,
    SLIP_X,
    SLIP_Y,
    STATES,
    THETA,
    V_X,
    V_Y,
    YAW_SLIP,
    X,
    Y,
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
        frame_per_m, frame_per_s, frame_turn: drift of the camera's frame, m^2/m, m^2/s and rad^2/s.
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
    frame_per_m: float
    frame_per_s: float
    frame_turn: float


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
        "frame_per_m": camera.drift_per_sqrt_m**2 * drifts,
        "frame_per_s": camera.drift_per_sqrt_s**2 * drifts,
        "frame_turn": camera.yaw_drift_per_sqrt_s**2 * drifts,
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
def move(x: Array, dt_s: float, slip_s: float) -> None:
    """State (20,) after `dt_s`: SE(2) exponential of the body twist, decay of the slip velocity."""
    h = 0.5 * x[OMEGA] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[THETA] + h), math.sin(x[THETA] + h)
    x[X] += k * (c * x[V_X] - s * x[V_Y])
    x[Y] += k * (s * x[V_X] + c * x[V_Y])
    x[THETA] += x[OMEGA] * dt_s
    decay = math.exp(-dt_s / slip_s)
    x[SLIP_X] *= decay
    x[SLIP_Y] *= decay


@compiled
def transition(x: Array, dt_s: float, slip_s: float) -> Array:
    """Derivative (20, 20) of `move` by the state."""
    f = np.eye(STATES)
    h = 0.5 * x[OMEGA] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[THETA] + h), math.sin(x[THETA] + h)
    ahead, left = c * x[V_X] - s * x[V_Y], s * x[V_X] + c * x[V_Y]
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    f[X, THETA], f[Y, THETA] = -k * left, k * ahead
    f[X, V_X], f[X, V_Y] = k * c, -k * s
    f[Y, V_X], f[Y, V_Y] = k * s, k * c
    f[X, OMEGA] = slope * ahead - 0.5 * dt_s * k * left
    f[Y, OMEGA] = slope * left + 0.5 * dt_s * k * ahead
    f[THETA, OMEGA] = dt_s
    f[SLIP_X, SLIP_X] = f[SLIP_Y, SLIP_Y] = math.exp(-dt_s / slip_s)
    return f


@compiled
def _drift(x: Array, p: Array, dt_s: float, rolled: float, par: ProcessParameters) -> None:
    """Drift of the camera's frame: it shifts, and it turns about the robot, not about its own origin."""
    shift = par.frame_per_m * rolled + par.frame_per_s * dt_s
    p[FRAME_X, FRAME_X] += shift
    p[FRAME_Y, FRAME_Y] += shift
    q = par.frame_turn * dt_s
    gx, gy = x[Y] - x[FRAME_Y], x[FRAME_X] - x[X]
    p[FRAME_X, FRAME_X] += q * gx * gx
    p[FRAME_Y, FRAME_Y] += q * gy * gy
    p[FRAME_THETA, FRAME_THETA] += q
    p[FRAME_X, FRAME_Y] += q * gx * gy
    p[FRAME_Y, FRAME_X] += q * gx * gy
    p[FRAME_X, FRAME_THETA] += q * gx
    p[FRAME_THETA, FRAME_X] += q * gx
    p[FRAME_Y, FRAME_THETA] += q * gy
    p[FRAME_THETA, FRAME_Y] += q * gy


@compiled
def add_noise(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Add the process noise of a step that began at state x, with exact powers of its length."""
    speed = math.sqrt(x[V_X] * x[V_X] + x[V_Y] * x[V_Y])
    rolled = speed * dt_s
    c, s = math.cos(x[THETA]), math.sin(x[THETA])
    q, turn = par.acceleration, par.angular_acceleration
    half, third = 0.5 * dt_s * dt_s, dt_s * dt_s * dt_s / 3.0
    p[X, X] += q * third
    p[Y, Y] += q * third
    p[THETA, THETA] += turn * third
    p[V_X, V_X] += q * dt_s
    p[V_Y, V_Y] += q * dt_s
    p[OMEGA, OMEGA] += turn * dt_s
    for i, j, value in ((X, V_X, c), (Y, V_X, s), (X, V_Y, -s), (Y, V_Y, c)):
        p[i, j] += value * q * half
        p[j, i] += value * q * half
    p[THETA, OMEGA] += turn * half
    p[OMEGA, THETA] += turn * half
    p[BIAS, BIAS] += par.bias * dt_s
    p[YAW_SLIP, YAW_SLIP] += par.yaw_slip * rolled
    renewed = 1.0 - math.exp(-2.0 * dt_s / par.slip_s)
    p[SLIP_X, SLIP_X] += par.slip_x * renewed
    p[SLIP_Y, SLIP_Y] += par.slip_y * renewed
    p[CREEP_X, CREEP_X] += par.creep_x * rolled
    p[CREEP_Y, CREEP_Y] += par.creep_y * rolled
    _drift(x, p, dt_s, rolled, par)


@compiled
def advance_linear(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Extended Kalman prediction, in place; the product F P F' is written out for the rows that change."""
    h = 0.5 * x[OMEGA] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[THETA] + h), math.sin(x[THETA] + h)
    ahead, left = c * x[V_X] - s * x[V_Y], s * x[V_X] + c * x[V_Y]
    slope = 0.5 * dt_s * dt_s * sinc_slope(h)
    ax, bx, cx = -k * left, k * c, -k * s
    ay, by, cy = k * ahead, k * s, k * c
    wx, wy = slope * ahead - 0.5 * dt_s * k * left, slope * left + 0.5 * dt_s * k * ahead
    decay = math.exp(-dt_s / par.slip_s)
    for _ in range(2):
        for i in range(STATES):
            p[X, i] += ax * p[THETA, i] + bx * p[V_X, i] + cx * p[V_Y, i] + wx * p[OMEGA, i]
            p[Y, i] += ay * p[THETA, i] + by * p[V_X, i] + cy * p[V_Y, i] + wy * p[OMEGA, i]
            p[THETA, i] += dt_s * p[OMEGA, i]
            p[SLIP_X, i] *= decay
            p[SLIP_Y, i] *= decay
        for i in range(STATES):
            for j in range(i):
                p[i, j], p[j, i] = p[j, i], p[i, j]
    for i in range(STATES):
        for j in range(i):
            p[i, j] = p[j, i]
    add_noise(x, p, dt_s, par)
    move(x, dt_s, par.slip_s)
