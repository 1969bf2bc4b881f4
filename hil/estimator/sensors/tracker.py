"""Tracking camera: pose in a frame of its own.

The state contains this pose as well. It moves with the pose in the wall frame, (1 + scale) times as far, and
drifts (`hil.estimator.process_model`). It starts at the camera's first pose and again after a jump.
"""

import math

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.estimator.sensors.measured_noise import START as FIRST
from hil.estimator.sensors.measured_noise import MeasuredNoise, measure
from hil.estimator.sensors.pose_sensor import POSE_ROWS, PoseRow, inflate_pose_variance, pack_pose, read
from hil.estimator.sensors.sensor import (
    DUPLICATE,
    NEW_FRAME,
    REFUSED,
    USED,
    Tally,
    account_together,
    is_repeated,
)
from hil.estimator.state_vector import CAMERA_X, ROWS
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

NAME = "tracker"
NONLINEAR = False
ANGLE_ROW = 2
GATED_TOGETHER = True
START = {
    "t_ns": -1.0,
    "frame_t_ns": -1.0,
    "tally.nis_mean": 1.0,
    **{f"noise_{row}.{name}": value for row in ("x", "y", "heading") for name, value in FIRST.items()},
}
FIGURES = {
    "nis_tracker": "tally.nis",
    "nis_mean_tracker": "tally.nis_mean",
    "innovation_tracker_m": "innovation_m",
    "rejected_tracker": "tally.rejected",
    "reanchored_tracker": "tally.reanchored",
    "noise_tracker_x": "noise_x.factor",
    "noise_tracker_y": "noise_y.factor",
    "noise_tracker_heading": "noise_heading.factor",
}

DOUBTED = 4.0
"""Factor on the variances of a pose below the best quality."""
_BEST_QUALITY = 3.0
_NO_GATE = 1e300

Row = PoseRow
pack = pack_pose


class Parameters(Record):
    """Parameters of the camera's kernels.

    Attributes:
        used: flag: 1 where the camera is used, else 0.
        position, heading: variances of a pose, m^2 and rad^2.
        quality: least quality of a usable pose.
        baseline_s: time after which the frame is started again; 0: never.
        jump_m, jump_rad, fastest_m_s, fastest_rad_s: limits of a step: beyond jump + fastest * time it is a
            jump.
    """

    used: float
    position: float
    heading: float
    quality: float
    baseline_s: float
    jump_m: float
    jump_rad: float
    fastest_m_s: float
    fastest_rad_s: float


class Memory(Record):
    """The last pose and the present frame.

    Attributes:
        t_ns: stamp of the last pose; negative before the first.
        frame_t_ns: stamp at which the present frame started; negative before the first.
        x_m, y_m, heading_rad: the last pose in the camera's frame.
        innovation_m, innovation_rad: innovation of position and heading.
        noise_x, noise_y, noise_heading: measured noise of each row.
        tally: tally of all rows.
    """

    t_ns: float
    frame_t_ns: float
    x_m: float
    y_m: float
    heading_rad: float
    innovation_m: float
    innovation_rad: float
    noise_x: MeasuredNoise
    noise_y: MeasuredNoise
    noise_heading: MeasuredNoise
    tally: Tally


def is_used(config: EstimatorConfig) -> bool:
    """Always True: poses of a camera that is switched off are counted as refused."""
    return True


def values(config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> dict[str, float]:
    """Values of `Parameters`."""
    t, relative = config.tracker, config.tracker.use == "relative"
    return {
        "used": t.use != "off",
        "position": t.position_m**2,
        "heading": t.heading_rad**2,
        "quality": t.least_quality,
        "baseline_s": t.baseline_s * relative,
        "jump_m": t.jump_m if relative else _NO_GATE,
        "jump_rad": t.jump_rad if relative else _NO_GATE,
        "fastest_m_s": t.fastest_m_s,
        "fastest_rad_s": t.fastest_rad_s,
    }


@inner
def weigh(m: Memory, row: Row, par: Parameters, z: Array, var: Array) -> int:
    """Fill the three measured rows; the variance is larger below the best quality, and for a noisy camera."""
    factor = DOUBTED if row.quality < _BEST_QUALITY else 1.0
    rows = read(row, par.position * factor, par.heading * factor, z, var)
    var[0] *= m.noise_x.factor
    var[1] *= m.noise_y.factor
    var[2] *= m.noise_heading.factor
    return rows


@inner
def new_frame(t_ns: float, x: Array, p: Array, m: Memory, row: Row, par: Parameters) -> None:
    """Start the frame at this pose: set the pose in the camera's frame to it, with its noise."""
    z, var = np.zeros(ROWS), np.zeros(ROWS)
    weigh(m, row, par, z, var)
    for i in range(POSE_ROWS):
        x[CAMERA_X + i] = z[i]
        p[CAMERA_X + i, :] = 0.0
        p[:, CAMERA_X + i] = 0.0
    for i in range(POSE_ROWS):
        p[CAMERA_X + i, CAMERA_X + i] = var[i]
    m.frame_t_ns = t_ns


@inner
def admit(t_ns: float, m: Memory, row: Row, par: Parameters) -> int:
    """Refuse a pose of low quality; start a new frame where the robot cannot have made the step."""
    if is_repeated(t_ns, m.t_ns):
        return DUPLICATE
    if par.used <= 0.0 or row.valid <= 0.0 or row.quality < par.quality:
        m.tally.rejected += 1.0
        return REFUSED
    if m.frame_t_ns < 0.0:
        return NEW_FRAME
    dt_s = (t_ns - m.t_ns) * 1e-9
    far_m = math.hypot(row.x_m - m.x_m, row.y_m - m.y_m)
    turn_rad = abs(row.heading_rad - m.heading_rad)
    if far_m > par.jump_m + par.fastest_m_s * dt_s or turn_rad > par.jump_rad + par.fastest_rad_s * dt_s:
        m.tally.reanchored += 1.0
        m.tally.in_row = 0.0
        return NEW_FRAME
    return USED


@inner
def observe(t_ns: float, m: Memory, row: Row, par: Parameters, z: Array, var: Array, aux: Array) -> int:
    """Measured pose with its variances."""
    return weigh(m, row, par, z, var)


@inner
def predicted(x: Array, aux: Array, par: Parameters, out: Array) -> None:
    """Predicted pose in the camera's frame."""
    for i in range(POSE_ROWS):
        out[i] = x[CAMERA_X + i]


@inner
def jacobian(x: Array, aux: Array, par: Parameters, h: Array) -> None:
    """Derivative of `predicted` by the state."""
    for i in range(POSE_ROWS):
        h[i, CAMERA_X + i] = 1.0


@inner
def account(m: Memory, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float) -> int:
    """Count all rows in one tally."""
    m.innovation_m, m.innovation_rad = math.hypot(nu[0], nu[1]), nu[ANGLE_ROW]
    return account_together(m.tally, nis, var, count, gate, samples)


@inner
def reanchor(limit: float, t_ns: float, p: Array, m: Memory, par: Parameters) -> bool:
    """Request a new frame after too many rejections, or when a baseline has ended.

    After rejections the wall pose gets the variance of the last innovation, since the new frame discards it.
    """
    if m.tally.in_row >= limit:
        m.tally.reanchored += 1.0
        m.tally.in_row = 0.0
        inflate_pose_variance(p, m.innovation_m**2, m.innovation_rad**2)
        return True
    return par.baseline_s > 0.0 and (t_ns - m.frame_t_ns) * 1e-9 >= par.baseline_s


@inner
def remember(t_ns: float, x: Array, p: Array, m: Memory, row: Row, par: Parameters) -> None:
    """Store stamp and pose, and measure the noise."""
    dt_s, factor = (t_ns - m.t_ns) * 1e-9, DOUBTED if row.quality < _BEST_QUALITY else 1.0
    measure(m.noise_x, row.x_m, dt_s, par.position * factor)
    measure(m.noise_y, row.y_m, dt_s, par.position * factor)
    measure(m.noise_heading, row.heading_rad, dt_s, par.heading * factor)
    m.t_ns = t_ns
    m.x_m, m.y_m, m.heading_rad = row.x_m, row.y_m, row.heading_rad


@inner
def undo(t_ns: float, x: Array, m: Memory, row: Row, par: Parameters, late: Array, spread: Array) -> None:
    """Carry back through a new frame, if one started here: it does not depend on the state before."""
    if m.frame_t_ns != t_ns:
        return
    for i in range(POSE_ROWS):
        late[CAMERA_X + i] = 0.0
        spread[CAMERA_X + i, :] = 0.0
        spread[:, CAMERA_X + i] = 0.0
