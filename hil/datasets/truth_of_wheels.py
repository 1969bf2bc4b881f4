"""Finds ground truth that was computed from the wheels: it shows nothing of what the wheels do not know.

Odometry of any geometry is a linear function of the wheel vectors. What a measured path leaves beside the
best such function is at least the noise of the capture system and the rounding of the encoders: 10 um
together, where either is far better than usual. A path that was integrated from these very wheel angles
leaves what its file rounds.
"""

import numpy as np

from hil.core.geometry import Array
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import is_slow, truth_window, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import wheel_vectors

_STRIDE_S, _FEWEST = 0.2, 24
_ROLLED_M = 1e-4
_MEASURED_M = 4e-6
"""Least deviation that a measured path has from one by the wheels, m, in strides of 0.2 s."""


def of_wheels(recording: Recording) -> str:
    """A sentence where the ground truth was computed from the wheels of its recording; else empty."""
    left_m = _left_m(recording)
    if left_m > _MEASURED_M:
        return ""
    return (
        f"its ground truth was computed from these wheel angles: it deviates by {1e6 * left_m:.1f} um from "
        f"what they give, and a measured one by {1e6 * _MEASURED_M:.0f} um at least; nothing can be "
        "calibrated on odometry: take the poses of a capture system"
    )


def _left_m(recording: Recording) -> float:
    """Deviation, m, root mean square at the wheels, of moves over 0.2 s; infinite where there are too few."""
    at_s, pose = truth_window(recording)
    if len(at_s) < 2 or is_slow(at_s):
        return np.inf
    rotation, steering = wheel_steps(recording, at_s, "position")
    u = wheel_vectors(rotation * recording.nominal.geometry.radius_m, steering).reshape(len(rotation), 8)
    rows = np.flatnonzero(np.diff(np.floor((at_s - at_s[0]) / _STRIDE_S), prepend=-1.0))[:-1]
    rolled, moved = (np.add.reduceat(steps, rows, axis=0) for steps in (u, _steps(pose, recording)))
    rolls = np.abs(rolled).max(axis=1) > _ROLLED_M
    if np.count_nonzero(rolls) < _FEWEST:
        return np.inf
    rolled, moved = rolled[rolls], moved[rolls]
    left = moved - rolled @ np.linalg.lstsq(rolled, moved, rcond=1e-4)[0]
    return float(np.sqrt(np.mean(left**2)))


def _steps(pose: Array, recording: Recording) -> Array:
    """Steps (n - 1, 3), m, of poses (n, 3) in the body's frame: ahead, left, turned at the wheels."""
    x, y, turn = np.diff(pose, axis=0).T
    moved = (x + 1j * y) * np.exp(-0.5j * (pose[1:, 2] + pose[:-1, 2]))
    return np.stack([moved.real, moved.imag, lever_m(recording.nominal.geometry) * turn], axis=1)
