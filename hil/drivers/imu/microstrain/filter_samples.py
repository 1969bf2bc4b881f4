"""Converts a set of filter data to a sample in the conventions of the bench, with its status.

The sensor's gravity points down and its attitude is with respect to north, east, down: flat and at rest it
reports gravity (0, 0, +9.8), its accelerometer measures (0, 0, -9.8), the specific force, and linear
acceleration is the sum of the two. A sample's gravity points up, which is the negative, and its attitude
is with respect to north, west, up. Rates and linear acceleration stay as they are.
"""

import math

import numpy as np

from hil.core.geometry import multiplied
from hil.core.signals import ImuSample, Stamp, Status
from hil.links.mip import fields as f

WITH_VALUES = (Status.OK, Status.FROZEN, Status.IMPLAUSIBLE, Status.STALE)
"""Statuses whose samples have the measured values; all others have NaN."""

_NED_TO_UP = (0.0, 1.0, 0.0, 0.0)
_NORM_LOW, _NORM_HIGH = 0.95**2, 1.05**2
_GRAVITY_LOW, _GRAVITY_HIGH = 9.3**2, 10.3**2
_FASTEST_RAD_S, _STRONGEST_M_S2 = 40.0, 400.0
_NAN3, _NAN4 = np.full(3, np.nan), np.full(4, np.nan)


def judge(data: f.FilterData) -> Status:
    """Status of filter data, by its flags, its validity and its values."""
    if data.flags & f.SOLUTION_ERROR:
        return Status.HARDWARE_ERROR
    if data.state < f.FIRST_RUNNING_STATE or not data.valid:
        return Status.STARTING
    values = (*data.quaternion_wxyz, *data.rate_rad_s, *data.linear_m_s2, *data.gravity_m_s2)
    if not all(map(math.isfinite, values)):
        return Status.NOT_FINITE
    return Status.OK if _plausible(data) else Status.IMPLAUSIBLE


def _plausible(data: f.FilterData) -> bool:
    """Whether a real sensor could have measured this."""
    return (
        _NORM_LOW < sum(v * v for v in data.quaternion_wxyz) < _NORM_HIGH
        and _GRAVITY_LOW < sum(v * v for v in data.gravity_m_s2) < _GRAVITY_HIGH
        and max(map(abs, data.rate_rad_s)) < _FASTEST_RAD_S
        and max(map(abs, data.linear_m_s2)) < _STRONGEST_M_S2
    )


def sample(data: f.FilterData, stamp: Stamp, status: Status) -> ImuSample:
    """Filter data as a sample."""
    x, y, z = data.gravity_m_s2
    return ImuSample(
        stamp=stamp,
        quaternion_wxyz=np.array(multiplied(_NED_TO_UP, data.quaternion_wxyz)),
        gyro_rad_s=np.array(data.rate_rad_s),
        linear_acceleration_m_s2=np.array(data.linear_m_s2),
        gravity_m_s2=np.array((-x, -y, -z)),
        calibration=(),
        status=status,
    )


def empty(stamp: Stamp, status: Status) -> ImuSample:
    """A sample without values (NaN), whose status gives the reason."""
    return ImuSample(stamp, _NAN4, _NAN3, _NAN3, _NAN3, (), status)
