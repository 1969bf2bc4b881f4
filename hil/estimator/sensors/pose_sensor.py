"""Event row and intake shared by the sensors that measure a whole pose."""

import math
from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.core.signals import PoseMeasurement
from hil.estimator.sensors.sensor import FARTHEST_M, FARTHEST_RAD
from hil.estimator.state_vector import CLONE_X, THETA, X
from hil.support.numba_jit import inner

POSE_ROWS = 3
_THREE = (3,)


class PoseRow(Record):
    """One pose (m, m, rad) in the sensor's frame; `quality` is 0 to 3, `valid` 1 or 0."""

    x_m: float
    y_m: float
    heading_rad: float
    quality: float
    valid: float


def pack_pose(sample: PoseMeasurement) -> Sequence[float] | str:
    """Event row (5,) of a pose, or the reason of refusal."""
    pose = np.asarray(sample.pose)
    if pose.shape != _THREE:
        return "shape"
    x_m, y_m, heading_rad = pose.tolist()
    if not math.isfinite(x_m + y_m + heading_rad):
        return "not_finite"
    if abs(x_m) > FARTHEST_M or abs(y_m) > FARTHEST_M or abs(heading_rad) > FARTHEST_RAD:
        return "implausible"
    return x_m, y_m, heading_rad, sample.quality, sample.valid


@inner
def read(row: PoseRow, var_m: float, var_rad: float, z: Array, var: Array) -> int:
    """Fill the three measured rows of a pose and their variances, m^2 and rad^2; return their number."""
    z[0], z[1], z[2] = row.x_m, row.y_m, row.heading_rad
    var[0] = var[1] = var_m
    var[2] = var_rad
    return POSE_ROWS


@inner
def inflate_pose_variance(p: Array, var_m: float, var_rad: float) -> None:
    """Raise the variance of the pose and of its clone alike, in place.

    The clone is included because the wheels measure only the displacement between both.

    Args:
        p: (20, 20) covariance, changed in place.
        var_m: variance to add along each axis, m^2.
        var_rad: variance to add to the heading, rad^2.
    """
    for i in range(POSE_ROWS):
        more = var_rad if X + i == THETA else var_m
        for j in (X + i, CLONE_X + i):
            p[j, X + i] += more
            p[j, CLONE_X + i] += more
