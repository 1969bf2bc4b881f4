"""Motion capture: the pose in the wall frame. Off by default, because it is the reference for the others."""

import math

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.estimator.sensors.pose_sensor import PoseRow, inflate_pose_variance, pack_pose, read
from hil.estimator.sensors.sensor import (
    DUPLICATE,
    REFUSED,
    USED,
    Tally,
    account_together,
    is_repeated,
    no_frame,
    undo_nothing,
)
from hil.estimator.state_vector import THETA, X, Y
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

NAME = "mocap"
NONLINEAR = False
ANGLE_ROW = 2
GATED_TOGETHER = True
START = {"t_ns": -1.0, "tally.nis_mean": 1.0}
FIGURES = {"nis_mocap": "tally.nis", "nis_mean_mocap": "tally.nis_mean", "rejected_mocap": "tally.rejected"}

new_frame = no_frame
undo = undo_nothing
Row = PoseRow
pack = pack_pose


class Parameters(Record):
    """Use of the poses (1 or 0), and their variances, m^2 and rad^2."""

    used: float
    position: float
    heading: float


class Memory(Record):
    """Stamp of the last pose (negative before the first), its innovation, and a tally of the rows."""

    t_ns: float
    innovation_m: float
    tally: Tally


def is_used(config: EstimatorConfig) -> bool:
    """Whether `[estimator]` switches motion capture on."""
    return config.mocap.use


def values(config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> dict[str, float]:
    """Values of `Parameters`."""
    c = config.mocap
    return {"used": c.use, "position": c.position_m**2, "heading": c.heading_rad**2}


@inner
def admit(t_ns: float, m: Memory, row: Row, par: Parameters) -> int:
    """Accept every valid pose whose stamp is new, if the poses are used."""
    if is_repeated(t_ns, m.t_ns):
        return DUPLICATE
    if par.used > 0.0 and row.valid > 0.0:
        return USED
    m.tally.rejected += 1.0
    return REFUSED


@inner
def observe(t_ns: float, m: Memory, row: Row, par: Parameters, z: Array, var: Array, aux: Array) -> int:
    """Measured pose with its variances."""
    return read(row, par.position, par.heading, z, var)


@inner
def predicted(x: Array, aux: Array, par: Parameters, out: Array) -> None:
    """Predicted pose in the wall frame."""
    out[0], out[1], out[2] = x[X], x[Y], x[THETA]


@inner
def jacobian(x: Array, aux: Array, par: Parameters, h: Array) -> None:
    """Derivative of `predicted` by the state."""
    h[0, X] = h[1, Y] = h[2, THETA] = 1.0


@inner
def account(m: Memory, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float) -> int:
    """Count all rows in one tally."""
    m.innovation_m = math.hypot(nu[0], nu[1])
    return account_together(m.tally, nis, var, count, gate, samples)


@inner
def reanchor(limit: float, t_ns: float, p: Array, m: Memory, par: Parameters) -> bool:
    """Raise the variance of the pose after too many rejections in a row."""
    if m.tally.in_row < limit:
        return False
    m.tally.in_row = 0.0
    m.tally.reanchored += 1.0
    inflate_pose_variance(p, 1.0, 1.0)
    return False


@inner
def remember(t_ns: float, x: Array, p: Array, m: Memory, row: Row, par: Parameters) -> None:
    """Store the stamp."""
    m.t_ns = t_ns
