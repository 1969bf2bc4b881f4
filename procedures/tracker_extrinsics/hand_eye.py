"""Mount, scale and time offset of a camera on the body, from its motion and the body's in the plane.

Over an interval the body turns by a rotation R about the surface normal and its origin moves by d (body
axes at the start). A camera at m, turned by Q in the body, then turns by Q' R Q and moves, in its own
axes at the start, by s Q' (d + (R - 1) m), s being the scale of its odometry: the AX = XB problem of
hand-eye calibration. The frames of both systems cancel, so neither has to be known, and drift of the
camera only counts within an interval. The camera's height cannot be found from motion in a plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hil.core.errors import DataError
from hil.core.geometry import Array, ArrayLike, quat_from_rotvec, quat_multiply
from hil.loop.driven_motion import LONGEST_GAP_S
from hil.procedure.sample_arrays import Series

INTERVAL_S = 0.5
_LOWEST_TURN_RAD, _SHORTEST_STEP_M = 0.01, 0.005
_FEWEST = 12
_SCALES = np.array([0.01, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01])


@dataclass(frozen=True)
class Intervals:
    """Camera motion between pairs of samples; n of them.

    Attributes:
        begin_s, end_s: (n,) stamps of the camera.
        moved_m: (n, 3) displacement in the camera's axes at the begin.
        turned: rotations, end relative to begin.
    """

    begin_s: Array
    end_s: Array
    moved_m: Array
    turned: Rotation

    def __len__(self) -> int:
        return len(self.begin_s)

    def only(self, kept: NDArray[np.bool_]) -> Intervals:
        """Return the rows for which `kept` (n,) is true."""
        return Intervals(self.begin_s[kept], self.end_s[kept], self.moved_m[kept], self.turned[kept])

    def seen_by(self, truth: Truth) -> Intervals:
        """Return the intervals whose begin and end motion capture saw."""
        return self.only(truth.sees(self.begin_s) & truth.sees(self.end_s))


@dataclass(frozen=True)
class Extrinsics:
    """Result of the calibration; uncertainties are half of the 95 % interval.

    Attributes:
        position_m, position_uncertainty_m: (2,) x and y in the body.
        rotation_wxyz: camera (robot axes) in the body.
        angles_rad, angles_uncertainty_rad: (3,) roll, pitch, yaw of the correction to the configured mount.
        scale, scale_uncertainty: the camera's distance over the true distance.
        late_s, late_uncertainty_s: delay of the camera's stamps behind the truth, and its uncertainty.
        position_rms_m, angle_rms_rad: RMS residuals, per interval and axis.
        outliers: share of intervals beyond four sigma.
        covariance: covariance (7, 7) of x, y, roll, pitch, yaw, scale, lateness: m, m, rad, rad, rad, 1, s.
    """

    position_m: Array
    position_uncertainty_m: Array
    rotation_wxyz: Array
    angles_rad: Array
    angles_uncertainty_rad: Array
    scale: float
    scale_uncertainty: float
    late_s: float
    late_uncertainty_s: float
    position_rms_m: float
    angle_rms_rad: float
    outliers: float
    covariance: Array


def intervals(seen: Series, span_s: float = INTERVAL_S) -> Intervals:
    """Return the motion of the camera over successive intervals."""
    t = seen.t_s
    marks = np.searchsorted(t, np.arange(t[0], t[-1], span_s)) if len(seen) else np.empty(0, dtype=int)
    marks = np.unique(np.minimum(marks, len(t) - 1))
    first, last = marks[:-1], marks[1:]
    close = (t[last] - t[first]) < 1.5 * span_s
    first, last = first[close], last[close]
    attitude = Rotation.from_quat(seen.values[:, [4, 5, 6, 3]]) if len(seen) else Rotation.identity(0)
    back = attitude[first].inv()
    moved = back.apply(seen.values[last, 0:3] - seen.values[first, 0:3])
    return Intervals(t[first], t[last], moved, back * attitude[last])


def join(parts: list[Intervals]) -> Intervals:
    """Join intervals of several motions, whose times must be on one axis."""
    return Intervals(
        np.concatenate([p.begin_s for p in parts]),
        np.concatenate([p.end_s for p in parts]),
        np.concatenate([p.moved_m for p in parts]),
        Rotation.concatenate([p.turned for p in parts]),
    )


class Truth:
    """The body's pose at any time, from motion capture."""

    def __init__(self, seen: Series) -> None:
        self._t_s, self._pose = seen.t_s, seen.values

    def sees(self, t_s: Array) -> NDArray[np.bool_]:
        """Return whether each time (n,) has samples near it, so that interpolation is allowed."""
        near = np.clip(np.searchsorted(self._t_s, t_s), 1, max(len(self._t_s) - 1, 1))
        away_s = np.minimum(*(np.abs(np.take(self._t_s, k, mode="clip") - t_s) for k in (near - 1, near)))
        return np.asarray(away_s <= 0.5 * LONGEST_GAP_S)

    def pose(self, t_s: Array) -> Array:
        """Return interpolated poses (n, 3); constant beyond the ends. The caller has to leave out gaps."""
        return np.column_stack([np.interp(t_s, self._t_s, self._pose[:, k]) for k in range(3)])

    def steps(self, begin_s: Array, end_s: Array) -> tuple[Array, Array]:
        """Return displacement (n, 2) in body axes at the begin, and turn (n,)."""
        a, b = self.pose(begin_s), self.pose(end_s)
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        return np.column_stack([c * dx + s * dy, c * dy - s * dx]), b[:, 2] - a[:, 2]


def predict(z: Array, believed_wxyz: ArrayLike, step_m: Array, turn: Array) -> tuple[Array, Rotation]:
    """Predict camera motion (n, 3) and turn for (x, y, rotation vector (3), scale - 1, lateness)."""
    mount = _mount(z, believed_wxyz)
    c, s = np.cos(turn) - 1.0, np.sin(turn)
    moved = np.column_stack(
        [step_m[:, 0] + c * z[0] - s * z[1], step_m[:, 1] + s * z[0] + c * z[1], np.zeros(len(turn))]
    )
    about = Rotation.from_rotvec(np.column_stack([np.zeros((len(turn), 2)), turn]))
    return (1.0 + z[5]) * mount.inv().apply(moved), mount.inv() * about * mount


def _mount(z: Array, believed_wxyz: ArrayLike) -> Rotation:
    believed = np.asarray(believed_wxyz, dtype=np.float64)
    return Rotation.from_rotvec(z[2:5]) * Rotation.from_quat(believed[[1, 2, 3, 0]])


def solve(parts: Intervals, truth: Truth, believed_m: ArrayLike, believed_wxyz: ArrayLike) -> Extrinsics:
    """Solve by least squares over all intervals with motion.

    Position and angle are weighted by their scatter, which is estimated too; outliers get little weight.

    Raises:
        DataError: too few usable intervals, because the camera was not tracking or hardly moved.
    """
    from scipy.optimize import least_squares  # takes 0.5 s to import, not needed to drive

    x, y, _ = np.asarray(believed_m, dtype=np.float64)
    step_m, turn = truth.steps(parts.begin_s, parts.end_s)
    used = (np.abs(turn) > _LOWEST_TURN_RAD) | (np.hypot(*step_m.T) > _SHORTEST_STEP_M)
    if used.sum() < _FEWEST:
        raise DataError(
            "tracker",
            f"{int(used.sum())} usable intervals of {INTERVAL_S} s with motion",
            expected=f"at least {_FEWEST}",
            remedy="check confidence and light; drive further",
        )
    parts = parts.only(used)

    def errors(z: Array) -> tuple[Array, Array]:
        moved, turned = predict(z, believed_wxyz, *truth.steps(parts.begin_s - z[6], parts.end_s - z[6]))
        return parts.moved_m - moved, (turned.inv() * parts.turned).as_rotvec()

    z, sigma = np.array([x, y, 0.0, 0.0, 0.0, 0.0, 0.0]), (1e-3, 1e-3)
    for _ in range(3):

        def residuals(z: Array, sigma: tuple[float, float] = sigma) -> Array:
            moved, turned = errors(z)
            return np.concatenate([moved.ravel() / sigma[0], turned.ravel() / sigma[1]])

        found = least_squares(residuals, z, x_scale=_SCALES, loss="soft_l1", f_scale=3.0)
        z = found.x
        moved, turned = errors(z)
        sigma = _scatter(moved), _scatter(turned)
    jacobian: Array = np.asarray(least_squares(residuals, z, x_scale=_SCALES, max_nfev=1).jac)
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian), float)
    half = 2.0 * np.sqrt(np.diag(covariance))
    far = (np.abs(moved) > 4.0 * sigma[0]).any(axis=1) | (np.abs(turned) > 4.0 * sigma[1]).any(axis=1)
    return Extrinsics(
        z[0:2],
        half[0:2],
        quat_multiply(quat_from_rotvec(z[2:5]), believed_wxyz),
        z[2:5],
        half[2:5],
        1.0 + float(z[5]),
        float(half[5]),
        float(z[6]),
        float(half[6]),
        float(np.sqrt(np.mean(moved**2))),
        float(np.sqrt(np.mean(turned**2))),
        float(far.mean()),
        covariance,
    )


def _scatter(errors: Array) -> float:
    """Return the standard deviation from the median, robust against outliers."""
    return max(1.4826 * float(np.median(np.abs(errors))), 1e-7)


def lateness_curve(
    parts: Intervals, truth: Truth, found: Extrinsics, believed_wxyz: ArrayLike, late_s: Array
) -> Array:
    """Return the RMS error of the turn, rad, over assumed latencies: a sharp minimum is a good fit."""
    z = np.array([*found.position_m, *found.angles_rad, found.scale - 1.0, 0.0])
    values = []
    for late in late_s:
        steps = truth.steps(parts.begin_s - late, parts.end_s - late)
        turned = predict(z, believed_wxyz, *steps)[1]
        values.append(math.sqrt(float(np.mean((turned.inv() * parts.turned).as_rotvec() ** 2))))
    return np.array(values)


def camera_path(truth: Truth, t_s: Array, found: Extrinsics) -> Array:
    """Return the camera's position (n, 2), wall frame, from motion capture and the found mount."""
    pose = truth.pose(t_s)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = found.position_m
    return np.column_stack([pose[:, 0] + c * x - s * y, pose[:, 1] + s * x + c * y])


def laid_over(own_m: Array, wanted_m: Array) -> Array:
    """Align a path (n, 3) to another (n, 2) in the plane by rotation and shift (Kabsch); return (n, 2)."""
    middle = wanted_m.mean(axis=0)
    flat = np.column_stack([wanted_m - middle, np.zeros(len(wanted_m))])
    turn, _ = Rotation.align_vectors(flat, own_m - own_m.mean(axis=0))
    return np.asarray(turn.apply(own_m - own_m.mean(axis=0))[:, :2] + middle, dtype=np.float64)
