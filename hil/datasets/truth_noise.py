"""White noise of ground truth from row to row, and what it does to a way between two instants."""

from typing import cast

import numpy as np

from hil.core.geometry import Array
from hil.datasets.wheel_log import Recording

_ORDER, _FEWEST = 3, 20
_OF_DIFFERENCES = 20.0**0.5
"""Standard deviation of third differences of white noise of 1: the root of 1 + 9 + 9 + 1."""
_NORMAL = 1.4826
MEDIAN = (0.5 * np.pi) ** 0.5
"""Standard error of a median over that of a mean, of normal values."""


def white_noise(one: Recording) -> Array:
    """Standard deviations (3,), m, m, rad, of the rows of a ground truth about its path. Cached.

    Third differences of the rows leave nothing of the motion. Rows that repeat the one before are no
    measurements.
    """
    if "white_noise" not in one.derived:
        pose = one.truth_pose
        new = np.concatenate([[True], np.any(np.diff(pose, axis=0) != 0.0, axis=1)])
        left = np.diff(pose[new], n=_ORDER, axis=0)
        known = len(left) > _FEWEST
        one.derived["white_noise"] = (
            _NORMAL * np.median(np.abs(left), axis=0) / _OF_DIFFERENCES if known else np.zeros(3)
        )
    return cast("Array", one.derived["white_noise"])


def noise_of_ways_m(one: Recording) -> Array:
    """Standard deviations (5,), m, of a part of a way between two poses: of each wheel, and of the middle."""
    x, y, turn = white_noise(one)
    wheels = one.nominal.geometry
    place = wheels.x_m + 1j * wheels.y_m
    lever = np.abs(np.append(place, place.mean()))
    return np.asarray(np.sqrt(2.0 * (max(x, y) ** 2 + (lever * turn) ** 2)), dtype=np.float64)
