"""The register burst 0x14..0x35 of a BNO055: gyro, Euler, quaternion, acceleration, gravity, calibration.

Units as the driver selects them: 1/16 degree/s, 2^-14, 0.01 m/s^2 (datasheet 3.6.1). The Euler angles
are singular on a vertical wall and are not used.
"""

import math
import struct

import numpy as np

from hil.core.signals import ImuSample, Stamp, Status

START, LENGTH, MEASURED = 0x14, 34, 32

Counts = tuple[int, ...]

_LAYOUT = struct.Struct("<3h3h4h3h3hbB")
_numbers = np.frombuffer  # a name of this module: looking it up in numpy takes longer
_COUNT, _LEVELS = np.dtype("<i2"), 33
_RAD_S_PER_LSB = math.pi / 180.0 / 16.0
_SCALE = np.array([_RAD_S_PER_LSB] * 3 + [0.0] * 3 + [1.0 / 16384.0] * 4 + [0.01] * 6)
_NORM_LOW, _NORM_HIGH = (0.95 * 16384) ** 2, (1.05 * 16384) ** 2
_GRAVITY_LOW, _GRAVITY_HIGH = 930**2, 1030**2
_OK = Status.OK
_NAN3, _NAN4 = np.full(3, np.nan), np.full(4, np.nan)


def unpack(data: bytes) -> Counts:
    """Register counts of a burst of `LENGTH` bytes."""
    return _LAYOUT.unpack(data)


def judge(counts: Counts) -> Status:
    """STARTING for the zeros of a fusion that does not run, IMPLAUSIBLE for an impossible attitude."""
    w, x, y, z = counts[6:10]
    norm = w * w + x * x + y * y + z * z
    if norm == 0:
        return Status.STARTING
    gx, gy, gz = counts[13:16]
    up = gx * gx + gy * gy + gz * gz
    if _NORM_LOW < norm < _NORM_HIGH and _GRAVITY_LOW < up < _GRAVITY_HIGH:
        return _OK
    return Status.IMPLAUSIBLE


def sample(data: bytes, stamp: Stamp, status: Status) -> ImuSample:
    """The burst in SI units."""
    values = _SCALE * _numbers(data, _COUNT, _SCALE.size)
    levels = data[_LEVELS]
    return ImuSample(
        stamp,
        values[6:10],
        values[0:3],
        values[10:13],
        values[13:16],
        (levels >> 6, levels >> 4 & 3, levels >> 2 & 3, levels & 3),
        status,
    )


def empty(stamp: Stamp, status: Status) -> ImuSample:
    """A sample without values (NaN), whose status gives the reason."""
    return ImuSample(stamp, _NAN4, _NAN3, _NAN3, _NAN3, (0, 0, 0, 0), status)
