"""Gyro: yaw rate plus bias; and on a wall, from the same sample, the gravity heading plus an offset.

Two rows, each with its own variance, gate and tally. Gravity lies in the motion plane on a wall only. The
harder the body accelerates, the less certain the gravity heading is.
"""

import math
from collections.abc import Sequence

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.core.signals import GyroMeasurement
from hil.estimator.sensors.measured_noise import START as FIRST
from hil.estimator.sensors.measured_noise import MeasuredNoise, measure
from hil.estimator.sensors.sensor import (
    DUPLICATE,
    FARTHEST_RAD,
    USED,
    Tally,
    is_repeated,
    no_frame,
    tally,
    undo_nothing,
)
from hil.estimator.state_vector import BIAS, OFFSET, OMEGA, THETA
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

NAME = "gyro"
NONLINEAR = False
ANGLE_ROW = 1
GATED_TOGETHER = False
START = {
    "t_ns": -1.0,
    "rate.nis_mean": 1.0,
    "gravity.nis_mean": 1.0,
    **{f"{row}_noise.{name}": value for row in ("rate", "gravity") for name, value in FIRST.items()},
}
FIGURES = {
    "nis_gyro": "rate.nis",
    "nis_gravity": "gravity.nis",
    "nis_mean_gyro": "rate.nis_mean",
    "nis_mean_gravity": "gravity.nis_mean",
    "innovation_gyro_rad_s": "innovation_rad_s",
    "rejected_gyro": "rate.rejected",
    "rejected_gravity": "gravity.rejected",
    "noise_gyro": "rate_noise.factor",
    "noise_gravity": "gravity_noise.factor",
}

RATE, GRAVITY = 0, 1
"""Rows of a sample."""
_FASTEST_RAD_S, _HARDEST_M_S2 = 1e2, 1e3
_TWO = (2,)

new_frame = no_frame
undo = undo_nothing


class Parameters(Record):
    """Parameters of the gyro's kernels.

    Attributes:
        rate: variance of the rate, rad^2/s^2.
        gravity, gravity_pulled: variance of the gravity heading, rad^2, and its increase per squared body
            acceleration, rad^2/(m/s^2)^2.
        gravity_used: flag: 1 where the gravity heading is used, else 0.
    """

    rate: float
    gravity: float
    gravity_pulled: float
    gravity_used: float


class Memory(Record):
    """Stamp of the last sample (negative before the first), its innovation; noise and tally of each row."""

    t_ns: float
    innovation_rad_s: float
    rate_noise: MeasuredNoise
    gravity_noise: MeasuredNoise
    rate: Tally
    gravity: Tally


class Row(Record):
    """One sample: rate and gravity heading, NaN where missing; body acceleration without gravity."""

    rate_rad_s: float
    heading_rad: float
    ahead_m_s2: float
    left_m_s2: float


def is_used(config: EstimatorConfig) -> bool:
    """Always True."""
    return True


def values(config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> dict[str, float]:
    """Values of `Parameters`."""
    g = config.gyro
    return {
        "rate": g.rate_rad_s**2,
        "gravity": g.gravity_rad**2,
        "gravity_pulled": g.gravity_per_m_s2**2,
        "gravity_used": g.use_gravity and surface == "wall",
    }


def pack(sample: GyroMeasurement) -> Sequence[float] | str:
    """Event row (4,), or the reason of refusal; an implausible acceleration only voids the heading."""
    pull = np.asarray(sample.acceleration_m_s2, dtype=np.float64)
    if pull.shape != _TWO:
        return "shape"
    rate, heading = sample.yaw_rate_rad_s, sample.gravity_heading_rad
    if not (math.isfinite(rate) or math.isfinite(heading)):
        return "not_finite"
    ahead, left = pull.tolist()
    if abs(rate) > _FASTEST_RAD_S or abs(heading) > FARTHEST_RAD:
        return "implausible"
    if not (abs(ahead) < _HARDEST_M_S2 and abs(left) < _HARDEST_M_S2):
        heading, ahead, left = math.nan, 0.0, 0.0
    return rate, heading, ahead, left


@inner
def admit(t_ns: float, m: Memory, row: Row, par: Parameters) -> int:
    """Accept every sample whose stamp is new."""
    return DUPLICATE if is_repeated(t_ns, m.t_ns) else USED


@inner
def observe(t_ns: float, m: Memory, row: Row, par: Parameters, z: Array, var: Array, aux: Array) -> int:
    """Measured yaw rate and gravity heading with their variances."""
    z[RATE], z[GRAVITY] = row.rate_rad_s, row.heading_rad
    var[RATE] = par.rate * m.rate_noise.factor if math.isfinite(row.rate_rad_s) else -1.0
    pull = row.ahead_m_s2 * row.ahead_m_s2 + row.left_m_s2 * row.left_m_s2
    known = par.gravity_used > 0.0 and math.isfinite(row.heading_rad)
    gravity = par.gravity * m.gravity_noise.factor
    var[GRAVITY] = gravity + par.gravity_pulled * pull if known else -1.0
    return 2


@inner
def predicted(x: Array, aux: Array, par: Parameters, out: Array) -> None:
    """Predicted rows: yaw rate plus bias, heading plus offset."""
    out[RATE] = x[OMEGA] + x[BIAS]
    out[GRAVITY] = x[THETA] + x[OFFSET]


@inner
def jacobian(x: Array, aux: Array, par: Parameters, h: Array) -> None:
    """Derivative of `predicted` by the state."""
    h[RATE, OMEGA] = h[RATE, BIAS] = 1.0
    h[GRAVITY, THETA] = h[GRAVITY, OFFSET] = 1.0


@inner
def account(m: Memory, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float) -> int:
    """Count each row in its own tally, where the row was usable."""
    m.innovation_rad_s = nu[RATE]
    used = 0
    if var[RATE] > 0.0:
        passed = 1 if 0.0 <= nis[RATE] <= gate else 0
        tally(m.rate, nis[RATE], passed, 1, samples)
        used += passed
    if var[GRAVITY] > 0.0:
        passed = 1 if 0.0 <= nis[GRAVITY] <= gate else 0
        tally(m.gravity, nis[GRAVITY], passed, 1, samples)
        used += passed
    return used


@inner
def reanchor(limit: float, t_ns: float, p: Array, m: Memory, par: Parameters) -> bool:
    """Raise the variance of heading and offset, or of rate and bias, after too many rejections in a row."""
    if m.gravity.in_row >= limit:
        m.gravity.in_row = 0.0
        m.gravity.reanchored += 1.0
        p[THETA, THETA] += 0.0025
        p[OFFSET, OFFSET] += 0.0025
    if m.rate.in_row >= limit:
        m.rate.in_row = 0.0
        m.rate.reanchored += 1.0
        p[OMEGA, OMEGA] += 0.01
        p[BIAS, BIAS] += 0.01
    return False


@inner
def remember(t_ns: float, x: Array, p: Array, m: Memory, row: Row, par: Parameters) -> None:
    """Store the stamp, and measure the noise; that of gravity includes the pull of the body."""
    dt_s, ahead, left = (t_ns - m.t_ns) * 1e-9, row.ahead_m_s2, row.left_m_s2
    pulled = par.gravity_pulled * (ahead * ahead + left * left)
    measure(m.rate_noise, row.rate_rad_s, dt_s, par.rate)
    measure(m.gravity_noise, row.heading_rad, dt_s, par.gravity + pulled)
    m.t_ns = t_ns
