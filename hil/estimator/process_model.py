"""Process model: constant body twist on SE(2) with random accelerations, and slowly changing nuisance states.

`hil.estimator.constant_twist` moves the state; this module predicts the covariance.
"""

import math

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.estimator.constant_twist import apply_displacements, camera_displacement, slopes, wall_shift
from hil.estimator.matrix_loops import check_size
from hil.estimator.state_vector import (
    BIAS,
    CAMERA_THETA,
    CAMERA_X,
    CAMERA_Y,
    CREEP_X,
    CREEP_Y,
    OMEGA,
    SCALE,
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
from hil.support.numba_jit import inner

FADING = (THETA, CAMERA_THETA, SLIP_X, SLIP_Y)
MOVING = (X, Y, THETA, CAMERA_X, CAMERA_Y, CAMERA_THETA, SLIP_X, SLIP_Y)
"""Rows of the covariance that a prediction changes: FADING by the linear part alone, MOVING in all."""


class ProcessParameters(Record):
    """Process noise: variance per second, per rolled metre, or (slip velocity) in steady state.

    Attributes:
        acceleration, angular_acceleration: power densities, m^2/s^3 and rad^2/s^3.
        slip_x, slip_y: stationary variance of the slip velocity, m^2/s^2; `slip_s` is its time constant.
        creep_x, creep_y: random walk of the slip per rolled metre, 1/m.
        yaw_slip: random walk of the turn per rolled metre, rad^2/m^3.
        bias: random walk of the gyro bias, rad^2/s^3.
        sight_per_m, sight_per_s, sight_turn: drift of the camera, m^2/m, m^2/s and rad^2/s.
        scaled: flag: 1 where the scale state belongs to the camera, else 0.
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
    """Values of `ProcessParameters` from the configuration; `surface` is `wall` or `floor`."""
    slip, camera, noise = config.slip(surface), config.tracker, config.process
    drifts = camera.use == "relative"
    walk_x, walk_y = (
        slip.creep_per_sqrt_m * (part / slip.creep if slip.creep > 0 else 0.0)
        for part in (slip.creep, slip.creep_across)
    )
    return {
        "acceleration": noise.acceleration_m_s2_sqrt_hz**2,
        "angular_acceleration": noise.angular_acceleration_rad_s2_sqrt_hz**2,
        "slip_x": slip.slip_m_s**2,
        "slip_y": slip.slip_across_m_s**2,
        "slip_s": slip.slip_time_s,
        "creep_x": walk_x**2,
        "creep_y": walk_y**2,
        "yaw_slip": slip.yaw_per_sqrt_m**2,
        "bias": config.gyro.bias_rad_s_sqrt_s**2,
        "sight_per_m": camera.drift_per_sqrt_m**2 * drifts,
        "sight_per_s": camera.drift_per_sqrt_s**2 * drifts,
        "sight_turn": camera.yaw_drift_per_sqrt_s**2 * drifts,
        "scaled": camera.scale_sigma > 0,
    }


@inner
def _add_motion(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Add the noise of the twist to both poses, with their correlation: one twist moves both."""
    q, turn = par.acceleration, par.angular_acceleration
    half, third = 0.5 * dt_s * dt_s, dt_s * dt_s * dt_s / 3.0
    size = 1.0 + par.scaled * x[SCALE]
    p[V_X, V_X] += q * dt_s
    p[V_Y, V_Y] += q * dt_s
    p[OMEGA, OMEGA] += turn * dt_s
    for place, theta, scale in ((X, THETA, 1.0), (CAMERA_X, CAMERA_THETA, size)):
        c, s = scale * math.cos(x[theta]), scale * math.sin(x[theta])
        p[place, place] += scale * scale * q * third
        p[place + 1, place + 1] += scale * scale * q * third
        p[theta, theta] += turn * third
        p[theta, OMEGA] += turn * half
        p[OMEGA, theta] += turn * half
        for i, j, value in ((0, V_X, c), (1, V_X, s), (0, V_Y, -s), (1, V_Y, c)):
            p[place + i, j] += value * q * half
            p[j, place + i] += value * q * half
    between = x[CAMERA_THETA] - x[THETA]
    c, s = size * q * third * math.cos(between), size * q * third * math.sin(between)
    for i, j, value in ((0, 0, c), (0, 1, s), (1, 0, -s), (1, 1, c)):
        p[X + i, CAMERA_X + j] += value
        p[CAMERA_X + j, X + i] += value
    p[THETA, CAMERA_THETA] += turn * third
    p[CAMERA_THETA, THETA] += turn * third


@inner
def add_noise(x: Array, p: Array, dt_s: float, par: ProcessParameters) -> None:
    """Add the process noise of a step of `dt_s` from state x (20,) to p (20, 20).

    The result is exact in the length of the step.
    """
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
    p[CAMERA_X, CAMERA_X] += drift
    p[CAMERA_Y, CAMERA_Y] += drift
    p[CAMERA_THETA, CAMERA_THETA] += par.sight_turn * dt_s


@inner
def mirror(p: Array, rows: tuple[int, ...]) -> None:
    """Make p (20, 20) symmetric in the given rows, in rising order; the upper triangle counts."""
    check_size(p)
    for i in rows:
        for j in rows:
            if j < i:
                p[i, j] = p[j, i]
    for i in rows:
        for j in range(STATES):
            p[j, i] = p[i, j]


@inner
def fade_covariance(p: Array, dt_s: float, decay: float) -> None:
    """Apply F P F' for `advance_linear_states` to p (20, 20) in place: changing rows first, then columns."""
    check_size(p)
    for j in range(STATES):
        p[THETA, j] += dt_s * p[OMEGA, j]
        p[CAMERA_THETA, j] += dt_s * p[OMEGA, j]
        p[SLIP_X, j] *= decay
        p[SLIP_Y, j] *= decay
    for i in FADING:
        p[i, THETA] += dt_s * p[i, OMEGA]
        p[i, CAMERA_THETA] += dt_s * p[i, OMEGA]
        p[i, SLIP_X] *= decay
        p[i, SLIP_Y] *= decay
    mirror(p, FADING)


@inner
def advance_linear(x: Array, p: Array, dt_s: float, par: ProcessParameters, nominal: Array) -> None:
    """EKF prediction of x (20,), p (20, 20), in place; only changing rows and columns are computed."""
    check_size(p)
    a, b, c, d, (e, f) = slopes(x, dt_s, par.scaled, nominal)
    wall, sight = wall_shift(x, dt_s), camera_displacement(x, dt_s, par.scaled, x[SCALE], nominal)
    decay = math.exp(-dt_s / par.slip_s)
    for j in range(STATES):
        turned, seen, ahead, left = p[THETA, j], p[CAMERA_THETA, j], p[V_X, j], p[V_Y, j]
        spun, scale = p[OMEGA, j], p[SCALE, j]
        p[X, j] += a[0] * turned + a[1] * ahead + a[2] * left + a[3] * spun
        p[Y, j] += b[0] * turned + b[1] * ahead + b[2] * left + b[3] * spun
        p[CAMERA_X, j] += c[0] * seen + c[1] * ahead + c[2] * left + c[3] * spun + e * scale
        p[CAMERA_Y, j] += d[0] * seen + d[1] * ahead + d[2] * left + d[3] * spun + f * scale
        p[THETA, j], p[CAMERA_THETA, j] = turned + dt_s * spun, seen + dt_s * spun
        p[SLIP_X, j], p[SLIP_Y, j] = decay * p[SLIP_X, j], decay * p[SLIP_Y, j]
    for i in MOVING:
        turned, seen, ahead, left = p[i, THETA], p[i, CAMERA_THETA], p[i, V_X], p[i, V_Y]
        spun, scale = p[i, OMEGA], p[i, SCALE]
        p[i, X] += a[0] * turned + a[1] * ahead + a[2] * left + a[3] * spun
        p[i, Y] += b[0] * turned + b[1] * ahead + b[2] * left + b[3] * spun
        p[i, CAMERA_X] += c[0] * seen + c[1] * ahead + c[2] * left + c[3] * spun + e * scale
        p[i, CAMERA_Y] += d[0] * seen + d[1] * ahead + d[2] * left + d[3] * spun + f * scale
        p[i, THETA], p[i, CAMERA_THETA] = turned + dt_s * spun, seen + dt_s * spun
        p[i, SLIP_X], p[i, SLIP_Y] = decay * p[i, SLIP_X], decay * p[i, SLIP_Y]
    mirror(p, MOVING)
    add_noise(x, p, dt_s, par)
    apply_displacements(x, wall, sight, dt_s, decay)
