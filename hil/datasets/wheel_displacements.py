"""Displacements of each wheel in the body's frame: by its own angles, and by the ground truth at its place.

A way is complex: its real part ahead, its imaginary part to the left. With it one wheel can be compared with
the ground truth without the other three.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools
from hil.robot.kinematics import WheelGeometry

Complexes = npt.NDArray[np.complex128]

STRETCH_S = 0.5
_LONGEST_GAP_S = 0.25
_ROLLING, _LEAST_RAD = 0.3, 0.05


@dataclass(frozen=True)
class Drive:
    """Wheels and ground truth of one recording.

    Attributes:
        t_s: (n,) times of the wheel rows, s, increasing.
        angle: (n, 4) wheel angles.
        steering: (n, 4) steering angles.
        truth_t_s: (m,) times of the ground truth, s, increasing.
        pose: (m, 3) ground truth x, y, theta.
    """

    t_s: Array
    angle: Array
    steering: Array
    truth_t_s: Array
    pose: Array

    def edges_s(self) -> Array:
        """Edges (s + 1,), s, of stretches of half a second in the time that both cover."""
        begin_s, end_s = max(self.t_s[0], self.truth_t_s[0]), min(self.t_s[-1], self.truth_t_s[-1])
        return np.arange(begin_s, end_s, STRETCH_S)

    def known(self, edges_s: Array) -> Bools:
        """Mask (s,) of stretches in which the ground truth has no gap of a quarter of a second."""
        lasts_s = np.diff(self.truth_t_s)
        gap_s = max(_LONGEST_GAP_S, 1.5 * float(np.median(lasts_s)))
        gaps = np.concatenate([[0], np.cumsum(lasts_s > gap_s)])
        within = np.diff(np.interp(edges_s, self.truth_t_s, gaps)) == 0.0
        return np.asarray(within, dtype=np.bool_)


def by_wheels(drive: Drive, edges_s: Array, wheels: WheelGeometry) -> Complexes:
    """Ways (s, 4), m, between edges (s + 1,), by unwrapped wheel and steering angles, rad."""
    heading = 0.5 * (drive.steering[1:] + drive.steering[:-1]) - wheels.steering_zero_rad
    steps = np.diff(drive.angle, axis=0) * wheels.radius_m * np.exp(1j * heading)
    return _between(drive.t_s, np.vstack([np.zeros(4), np.cumsum(steps, axis=0)]), edges_s)


def by_truth(truth_t_s: Array, pose: Array, edges_s: Array, wheels: WheelGeometry) -> Complexes:
    """Ways (s, 4), m, between edges (s + 1,), by poses (m, 3) at times (m,); the heading is unwrapped."""
    place = np.interp(edges_s, truth_t_s, pose[:, 0]) + 1j * np.interp(edges_s, truth_t_s, pose[:, 1])
    theta = np.interp(edges_s, truth_t_s, pose[:, 2])
    turn, middle = np.diff(theta), 0.5 * (theta[1:] + theta[:-1])
    moved = np.diff(place) * np.exp(-1j * middle)
    return np.asarray(moved[:, None] + 1j * (wheels.x_m + 1j * wheels.y_m) * turn[:, None])


def rolling(rolled: Complexes, moved: Complexes, known: Bools, wheels: WheelGeometry) -> Bools:
    """Mask (s,) of known stretches in which wheels clearly roll, by either."""
    size = np.maximum(np.abs(rolled), np.abs(moved)).max(axis=1)
    least_m = _LEAST_RAD * float(np.mean(wheels.radius_m))
    typical_m = float(np.percentile(size, 90.0)) if len(size) else 0.0
    return np.asarray(known & (size > max(least_m, _ROLLING * typical_m)), dtype=np.bool_)


def missed(rolled: Complexes, moved: Complexes) -> Array:
    """Share (4,) of its true way that each wheel misses, of ways (s, 4)."""
    return np.asarray(np.abs(rolled - moved).sum(axis=0) / np.maximum(np.abs(moved).sum(axis=0), 1e-9))


def _between(t_s: Array, summed: Complexes, edges_s: Array) -> Complexes:
    real, imaginary = (
        np.column_stack([np.interp(edges_s, t_s, column) for column in part.T])
        for part in (summed.real, summed.imag)
    )
    return np.asarray(np.diff(real + 1j * imaginary, axis=0))
