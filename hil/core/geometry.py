"""Plane and space geometry: angles, SE(2), quaternions.

Conventions: SI units, angles in radians, quaternions `(w, x, y, z)`, a pose is `(x_m, y_m, theta_rad)`
of the body in some frame, a twist is `(v_x_m_s, v_y_m_s, omega_rad_s)` in the body frame.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Bools: TypeAlias = npt.NDArray[np.bool_]
ArrayLike: TypeAlias = npt.ArrayLike
Three: TypeAlias = tuple[float, float, float]
Four: TypeAlias = tuple[float, float, float, float]

_SMALL_ANGLE_RAD = 1e-4


def _floats(values: ArrayLike) -> list[float]:
    """Convert to plain Python floats: arithmetic on four floats is ten times quicker than on an array."""
    out = values.tolist() if isinstance(values, np.ndarray) else list(values)  # type: ignore[arg-type]
    return out  # type: ignore[return-value]


def wrap(angle_rad: float) -> float:
    """Angle wrapped into (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)


def nearest_turn(angle_rad: float, other_rad: float) -> float:
    """Angle less the whole turns that bring it within half a turn of another; to the bit where none do."""
    return angle_rad - 2.0 * math.pi * round((angle_rad - other_rad) / (2.0 * math.pi))


def wrap_array(angle_rad: ArrayLike) -> Array:
    """Angles of any shape, rad, wrapped into (-pi, pi]; NaN stays NaN."""
    return np.pi - np.mod(np.pi - np.asarray(angle_rad, dtype=np.float64), 2.0 * np.pi)


def mean_angle(angles_rad: Sequence[float]) -> float:
    """Mean of angles (rad) that lie within half a turn of the first; they may cross the wrap at pi.

    The mean is not wrapped; it is NaN without angles.
    """
    if not angles_rad:
        return math.nan
    first = angles_rad[0]
    return first + math.fsum(wrap(angle - first) for angle in angles_rad) / len(angles_rad)


def rotation2(theta_rad: float) -> Array:
    """2x2 rotation matrix that takes body vectors to the frame in which `theta_rad` is measured."""
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    return np.array((c, -s, s, c)).reshape(2, 2)


def se2_exp(delta: ArrayLike) -> Array:
    """SE(2) exponential of a body displacement.

    Args:
        delta: shape (3,), body twist times time: (m, m, rad).

    Returns:
        Shape (3,): the pose of the end frame in the start frame. Source: closed form of the
        left Jacobian of SO(2), series below 1e-4 rad (relative error below 1e-16).
    """
    dx, dy, dth = _floats(delta)
    if abs(dth) < _SMALL_ANGLE_RAD:
        a, b = 1.0 - dth * dth / 6.0, dth / 2.0 * (1.0 - dth * dth / 12.0)
    else:
        a, b = math.sin(dth) / dth, (1.0 - math.cos(dth)) / dth
    return np.array([a * dx - b * dy, b * dx + a * dy, dth])


def se2_log(pose: ArrayLike) -> Array:
    """Inverse of `se2_exp` for |theta| < pi. Shape (3,) in and out."""
    x, y, th = np.asarray(pose, dtype=np.float64)
    a = 1.0 - th * th / 12.0 if abs(th) < _SMALL_ANGLE_RAD else 0.5 * th / math.tan(0.5 * th)
    b = 0.5 * th
    return np.array([a * x + b * y, -b * x + a * y, th])


def compose(pose: ArrayLike, step: ArrayLike) -> Array:
    """Pose (3,) of frame C in A, from B in A (`pose`) and C in B (`step`), m and rad; not wrapped."""
    x, y, th = _floats(pose)
    dx, dy, dth = _floats(step)
    c, s = math.cos(th), math.sin(th)
    return np.array([x + c * dx - s * dy, y + s * dx + c * dy, th + dth])


def inverse(pose: ArrayLike) -> Array:
    """Pose (3,) of A in B from the pose of B in A, m and rad."""
    x, y, th = np.asarray(pose, dtype=np.float64)
    c, s = math.cos(th), math.sin(th)
    return np.array([-c * x - s * y, s * x - c * y, -th])


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose (3,) of frame B in A, both given in one common frame, m and rad. Heading is not wrapped."""
    return compose(inverse(a), b)


def multiplied(a_wxyz: Sequence[float], b_wxyz: Sequence[float]) -> Four:
    """Hamilton product of two quaternions, in plain floats for speed."""
    aw, ax, ay, az = a_wxyz
    bw, bx, by, bz = b_wxyz
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugated(q_wxyz: Sequence[float]) -> Four:
    """Conjugate of a quaternion, in plain floats."""
    w, x, y, z = q_wxyz
    return w, -x, -y, -z


def rotated(q_wxyz: Sequence[float], vector: Sequence[float]) -> Three:
    """Vector rotated by a unit quaternion, in plain floats."""
    w, x, y, z = q_wxyz
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def quat_multiply(a_wxyz: ArrayLike, b_wxyz: ArrayLike) -> Array:
    """Hamilton product of two quaternions, shape (4,)."""
    return np.array(multiplied(_floats(a_wxyz), _floats(b_wxyz)))


def quat_conjugate(q_wxyz: ArrayLike) -> Array:
    """Conjugate of a quaternion (4,): the inverse of a unit quaternion."""
    return np.array(conjugated(_floats(q_wxyz)))


def quat_rotate(q_wxyz: ArrayLike, vector: ArrayLike) -> Array:
    """Vector (3,) rotated by a unit quaternion: child coordinates to parent coordinates."""
    return np.array(rotated(_floats(q_wxyz), _floats(vector)))


def quat_from_yaw(yaw_rad: float) -> Array:
    """Unit quaternion (4,) of a rotation about z."""
    return np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])


def quat_from_rotvec(rotvec_rad: ArrayLike) -> Array:
    """Unit quaternion of a rotation vector (3,), rad."""
    r = np.asarray(rotvec_rad, dtype=np.float64)
    angle = float(np.linalg.norm(r))
    k = 0.5 - angle * angle / 48.0 if angle < _SMALL_ANGLE_RAD else math.sin(0.5 * angle) / angle
    return np.array([math.cos(0.5 * angle), *(k * r)])


def yaw_of_quat(q_wxyz: ArrayLike) -> float:
    """Rotation of a quaternion (4,) about z (the twist of a swing-twist split), rad in (-pi, pi].

    Unlike the Euler yaw it is defined for every attitude but a half turn about a horizontal axis.
    """
    w, _, _, z = _floats(q_wxyz)
    return wrap(2.0 * math.atan2(z, w))
