"""Poses of one body as a capture file holds them, and their motion in the plane in which the robot drives."""

from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.cleaning import UNIT_QUATERNION

_LEVER_M, _NEAR_M, _TIMES = 0.2, 5e-3, 3.0
_AXES = "xyz"


@dataclass(frozen=True)
class Poses:
    """Poses of a body in the frame of the file.

    Attributes:
        t_s: (n,) times, s.
        position_m: positions (n, 3), m; NaN where the body was not seen.
        rotation_wxyz: (n, 4) unit quaternions.
    """

    t_s: Array
    position_m: Array
    rotation_wxyz: Array

    def seen(self) -> Bools:
        """Mask (n,) of rows with a position and a rotation."""
        size = np.sum(self.rotation_wxyz**2, axis=1)
        known = np.isfinite(self.position_m).all(axis=1) & np.isfinite(self.t_s)
        return np.asarray(known & (size > UNIT_QUATERNION[0]) & (size < UNIT_QUATERNION[1]), dtype=np.bool_)


def planar(where: str, poses: Poses, usual_up: str) -> tuple[str, Array, Array]:
    """Axis of the plane's normal, times (m,) and poses (m, 3) in the plane, of the rows with a pose.

    The normal is the axis along which the body moves least and about which alone it turns; where the motion
    does not tell two axes apart, the one that such files have upwards.

    Args:
        where: the file, for messages.
        poses: poses of the body.
        usual_up: `x`, `y` or `z`.

    Raises:
        DataError: no row holds a pose.
    """
    seen = poses.seen()
    if not seen.any():
        raise DataError(
            where, "holds no pose of the body in any of its rows", expected="a body that was seen"
        )
    at, q = poses.position_m[seen], poses.rotation_wxyz[seen]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    out_m = _out_of_plane_m(at, q)
    up = usual_up if out_m[_AXES.index(usual_up)] < _TIMES * out_m.min() + _NEAR_M else _AXES[out_m.argmin()]
    order, sign = {"z": ((0, 1, 2), 1.0), "y": ((0, 2, 1), -1.0), "x": ((1, 2, 0), 1.0)}[up]
    signs = np.array([1.0, sign, 1.0])
    at, (x, y, z), w = at[:, order] * signs, (q[:, 1:][:, order] * signs).T, q[:, 0]
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return up, poses.t_s[seen], np.column_stack([at[:, :2], yaw])


def _out_of_plane_m(at: Array, q: Array) -> Array:
    """Motion (3,), m, out of the planes normal to x, y and z; tilt counts at 0.2 m."""
    spans_m = np.ptp(np.percentile(at, (2.0, 98.0), axis=0), axis=0)
    w, v = q[0, 0], q[0, 1:]
    turned = np.outer(q[:, 0], -v) + w * q[:, 1:] - np.cross(q[:, 1:], v)
    size = np.sum(turned**2, axis=1, keepdims=True)
    tilts = np.percentile(2.0 * np.sqrt(np.maximum(size - turned**2, 0.0)), 90.0, axis=0)
    return np.asarray(spans_m + _LEVER_M * tilts, dtype=np.float64)


def quat_of_vectors(vectors_rad: Array) -> Array:
    """Quaternions wxyz (n, 4) of rotation vectors (n, 3), rad."""
    angle = np.linalg.norm(vectors_rad, axis=1, keepdims=True)
    return np.hstack([np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * vectors_rad])


def quat_of_matrices(matrices: Array) -> Array:
    """Quaternions wxyz (n, 4) of rotation matrices (n, 3, 3); zeros where a matrix is none."""
    m = matrices
    diagonal = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]], axis=1)
    trace = diagonal.sum(axis=1)
    squares = np.column_stack([1.0 + trace, 1.0 + 2.0 * diagonal - trace[:, None]])
    size = np.sqrt(np.maximum(squares, 0.0)) * 0.5
    x, y, z = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    four = np.zeros_like(trace)
    ways = np.stack(
        [
            np.column_stack([four, x, y, z]),
            np.column_stack([x, four, xy, xz]),
            np.column_stack([y, xy, four, yz]),
            np.column_stack([z, xz, yz, four]),
        ],
        axis=1,
    )
    best = np.argmax(size, axis=1)
    rows = np.arange(len(m))
    largest = size[rows, best]
    out = ways[rows, best] / np.where(largest > 0.0, 4.0 * largest, np.inf)[:, None]
    out[rows, best] = largest
    real = np.abs(np.einsum("nij,nkj->nik", m, m) - np.eye(3)).max(axis=(1, 2)) < 0.1
    return np.where(real[:, None], out, 0.0)
