"""Maps between body motion and wheel motion of a robot with four steered and driven wheels.

Rigid-body constraint of wheel i at (x_i, y_i): its contact point moves with
(v_x - y_i w, v_y + x_i w) in the body frame (`facts/robot.md`, the paper's equation 1). Stacked over
the wheels this is P b = u with P (8, 3), body twist b = (v_x, v_y, w) and wheel vectors
u = (v_1 cos d_1, v_1 sin d_1, v_2 cos d_2, ...). Forward models, by name:

* `exact`: least squares, b = pinv(P) u, for any wheel positions.
* `paper`: the paper's mean velocities and K_i; equals `exact` only for the centred square robot.
* `dry-friction`: least dissipation, b = argmin sum_i |P_i b - u_i|; explains the real robot best
  (`facts/calibration.md`, section 3).

SI units; wheel order FL, BL, BR, FR; leading axes of wheel arrays are batch axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from hil.errors import UsageError
from hil.geometry import Array, ArrayLike

ForwardModel = Literal["exact", "paper", "dry-friction"]
MODELS: tuple[str, ...] = get_args(ForwardModel)

NOMINAL_HALF_BASE_M = 0.1125
NOMINAL_RADIUS_M = 0.0254

FRICTION_EPSILON = 2e-3
_POWERS = (2.0, 1.5, 1.2, 1.0)
_ITERATIONS = (1, 3, 3, 8)


def _four(value: ArrayLike) -> Array:
    out = np.array(value, dtype=np.float64)
    if out.shape != (4,) or not np.all(np.isfinite(out)):
        raise UsageError(f"wheel parameter {value!r}", expected="four finite numbers, FL, BL, BR, FR")
    out.setflags(write=False)
    return out


@dataclass(frozen=True)
class WheelGeometry:
    """Effective wheel parameters, shape (4,) each.

    Attributes:
        x_m, y_m: contact points in the body frame.
        radius_m: effective rolling radii.
        steering_zero_rad: subtract it from a measured steering angle to get the wheel's heading.
    """

    x_m: Array
    y_m: Array
    radius_m: Array
    steering_zero_rad: Array = field(default_factory=lambda: np.zeros(4))

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m", "radius_m", "steering_zero_rad"):
            object.__setattr__(self, name, _four(getattr(self, name)))
        if np.any(self.radius_m <= 0):
            raise UsageError(f"wheel radii {self.radius_m.tolist()} m", expected="all positive")
        if np.linalg.matrix_rank(self.projection()) < 3:
            raise UsageError("all wheels stand in one point: the turn rate cannot be seen")

    @classmethod
    def nominal(cls) -> WheelGeometry:
        """The CAD geometry (`facts/robot.md`): +-112.5 mm, radius 25.4 mm."""
        a = NOMINAL_HALF_BASE_M
        return cls(np.array([a, -a, -a, a]), np.array([a, a, -a, -a]), np.full(4, NOMINAL_RADIUS_M))

    @classmethod
    def from_vector(cls, z: ArrayLike) -> WheelGeometry:
        """Geometry of a parameter vector (12,) or (16,): x, y, radius and, if there, steering zeros."""
        v = np.asarray(z, dtype=np.float64)
        return cls(v[0:4], v[4:8], v[8:12], v[12:16] if v.size == 16 else np.zeros(4))

    def vector(self) -> Array:
        """Parameter vector (16,): x, y, radius, steering zero."""
        return np.concatenate([self.x_m, self.y_m, self.radius_m, self.steering_zero_rad])

    def projection(self) -> Array:
        """P, shape (8, 3): rows (v_x, v_y) of wheels 1..4 in turn."""
        return projection(self.x_m, self.y_m)


def projection(x_m: ArrayLike, y_m: ArrayLike) -> Array:
    """P (8, 3) of contact points (4,), (4,): wheel vectors of a body twist."""
    p = np.zeros((8, 3))
    p[0::2, 0] = 1.0
    p[1::2, 1] = 1.0
    p[0::2, 2] = -np.asarray(y_m, dtype=np.float64)
    p[1::2, 2] = np.asarray(x_m, dtype=np.float64)
    return p


def wheel_vectors(speed_m_s: ArrayLike, heading_rad: ArrayLike) -> Array:
    """Stacked wheel vectors (..., 8) of speeds (..., 4) and headings (..., 4)."""
    v, d = np.asarray(speed_m_s, dtype=np.float64), np.asarray(heading_rad, dtype=np.float64)
    u = np.empty((*np.broadcast_shapes(v.shape, d.shape)[:-1], 8))
    u[..., 0::2] = v * np.cos(d)
    u[..., 1::2] = v * np.sin(d)
    return u


def inverse(geometry: WheelGeometry, twist_body: ArrayLike) -> tuple[Array, Array]:
    """Wheel speeds (..., 4) m/s, never negative, and measured steering angles (..., 4) rad of a twist.

    The steering angle of a wheel at rest is its zero. Twists have shape (..., 3).
    """
    u = np.asarray(twist_body, dtype=np.float64) @ geometry.projection().T
    ux, uy = u[..., 0::2], u[..., 1::2]
    return np.hypot(ux, uy), np.arctan2(uy, ux) + geometry.steering_zero_rad


def forward(
    geometry: WheelGeometry,
    wheel_speed_m_s: ArrayLike,
    steering_rad: ArrayLike,
    model: str = "exact",
) -> Array:
    """Body twist (..., 3) of signed wheel speeds (..., 4) m/s and measured steering angles (..., 4) rad."""
    u = wheel_vectors(wheel_speed_m_s, np.asarray(steering_rad) - geometry.steering_zero_rad)
    return twist_of_vectors(geometry.x_m, geometry.y_m, u, model)


def twist_of_vectors(x_m: ArrayLike, y_m: ArrayLike, u: Array, model: str = "exact") -> Array:
    """Body motion (..., 3) of wheel vectors (..., 8), m/s or m per step alike."""
    if model == "dry-friction":
        flat = np.ascontiguousarray(u.reshape(-1, 8))
        return least_dissipation(projection(x_m, y_m), flat).reshape(*u.shape[:-1], 3)
    return np.asarray(u @ forward_matrix(x_m, y_m, model).T, dtype=np.float64)


def forward_matrix(x_m: ArrayLike, y_m: ArrayLike, model: str = "exact") -> Array:
    """Linear forward map (3, 8) from wheel vectors to the body twist, for `exact` and `paper`.

    Raises:
        UsageError: for another model's name.
    """
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    if model == "exact":
        return np.asarray(np.linalg.pinv(projection(x, y)), dtype=np.float64)
    if model != "paper":
        raise UsageError(f"forward model {model!r}", expected="one of " + ", ".join(MODELS))
    f = np.zeros((3, 8))
    f[0, 0::2] = f[1, 1::2] = 0.25
    rho = 4.0 * (x**2 + y**2)
    f[2, 0::2], f[2, 1::2] = -y / rho, x / rho
    return f


def forward_matrix_derivative(x_m: ArrayLike, y_m: ArrayLike, model: str = "exact") -> Array:
    """Derivative (8, 3, 8) of `forward_matrix` with respect to (x_1..4, y_1..4)."""
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    out = np.zeros((8, 3, 8))
    if model == "paper":
        rho = x**2 + y**2
        for i in range(4):
            out[i, 2, 2 * i] = 2 * x[i] * y[i] / (4 * rho[i] ** 2)
            out[i, 2, 2 * i + 1] = (rho[i] - 2 * x[i] ** 2) / (4 * rho[i] ** 2)
            out[4 + i, 2, 2 * i] = -(rho[i] - 2 * y[i] ** 2) / (4 * rho[i] ** 2)
            out[4 + i, 2, 2 * i + 1] = -2 * x[i] * y[i] / (4 * rho[i] ** 2)
        return out
    p = projection(x, y)
    f = forward_matrix(x, y, model)
    normal = np.linalg.inv(p.T @ p)
    for i in range(4):
        for k, (row, sign) in enumerate(((2 * i + 1, 1.0), (2 * i, -1.0))):
            dp = np.zeros((8, 3))
            dp[row, 2] = sign
            out[4 * k + i] = -f @ dp @ f + normal @ dp.T @ (np.eye(8) - p @ f)
    return out


def least_dissipation(p: Array, u: Array, load: Array | None = None, power: float = 1.0) -> Array:
    """Body motion (n, 3) that dissipates least against dry friction at four contacts.

    Minimises sum_i load_i psi(|P_i b - u_i|) with psi' (e) = e (e / s + eps)^(q - 2), the smoothed
    Coulomb friction at q = 1, s the block's mean wheel displacement. Iteratively reweighted least
    squares continued over q = 2, 1.5, 1.2, 1 (`facts/calibration.md` section 3), then Newton steps.

    Args:
        p: (8, 3) from `projection`.
        u: (n, 8) wheel vectors.
        load: (4,) relative normal loads; equal when None.
        power: q to stop at; 2 is least squares.
    """
    scale = displacement_scale(u)
    share = np.ones(4) if load is None else np.asarray(load, dtype=np.float64)
    b = np.asarray(u @ np.linalg.pinv(p).T, dtype=np.float64)
    for step, count in zip(_POWERS, _ITERATIONS, strict=True):
        if step >= power:
            for _ in range(count):
                b = _reweighted(p, u, b, scale, share, step)
    return polish_dissipation(p, u, b, scale, share, power=power)


def polish_dissipation(
    p: Array, u: Array, b: Array, scale: Array, share: Array, *, power: float = 1.0, steps: int = 3
) -> Array:
    """Newton steps on the smoothed dissipation from a start b (n, 3) that is already close."""
    for _ in range(steps):
        gradient, hessian = dissipation_derivatives(p, u, b, scale, share, power)
        b = _improve(p, u, b, scale, share, power, solve3(hessian, gradient))
    return b


def displacement_scale(u: Array) -> Array:
    """Mean wheel displacement (or speed) of each row of (n, 8), never zero."""
    return np.asarray(np.hypot(u[:, 0::2], u[:, 1::2]).mean(axis=1) + 1e-9, dtype=np.float64)


def _residuals(p: Array, u: Array, b: Array) -> tuple[Array, Array]:
    e = (b @ p.T - u).reshape(-1, 4, 2)
    return e, np.sqrt(np.einsum("nij,nij->ni", e, e))


def contact_weight(size: Array, scale: Array, share: Array, power: float) -> Array:
    """Weight (n, 4) of each contact: friction force per slip, from slip sizes (n, 4)."""
    return np.asarray(share * (size / scale[:, None] + FRICTION_EPSILON) ** (power - 2.0), dtype=np.float64)


def _reweighted(p: Array, u: Array, b: Array, scale: Array, share: Array, power: float) -> Array:
    _, size = _residuals(p, u, b)
    wide = np.repeat(contact_weight(size, scale, share, power), 2, axis=1)
    products = (p[:, :, None] * p[:, None, :]).reshape(8, 9)
    return solve3((wide @ products).reshape(-1, 3, 3), (wide * u) @ p)


def dissipation_derivatives(
    p: Array, u: Array, b: Array, scale: Array, share: Array, power: float = 1.0
) -> tuple[Array, Array]:
    """Gradient (n, 3) and Hessian (n, 3, 3) of the smoothed dissipation by the motion b."""
    e, size = _residuals(p, u, b)
    curvature = contact_curvature(e, size, scale, share, power)
    blocks = p.reshape(4, 2, 3)
    weight = contact_weight(size, scale, share, power)
    gradient = (np.repeat(weight, 2, axis=1) * e.reshape(-1, 8)) @ p
    products = np.einsum("iab,icd->iacbd", blocks, blocks).reshape(16, 9)
    return gradient, (curvature.reshape(-1, 16) @ products).reshape(-1, 3, 3)


def contact_curvature(e: Array, size: Array, scale: Array, share: Array, power: float = 1.0) -> Array:
    """Second derivative (n, 4, 2, 2) of each contact's dissipation by its slip e (n, 4, 2)."""
    weight = contact_weight(size, scale, share, power)
    relative = size / scale[:, None]
    bend = (power - 2.0) * weight * relative / (relative + FRICTION_EPSILON)
    n_x, n_y = (e[..., k] / np.maximum(size, 1e-30) for k in (0, 1))
    curvature = np.empty((*size.shape, 2, 2))
    curvature[..., 0, 0] = weight + bend * n_x * n_x
    curvature[..., 1, 1] = weight + bend * n_y * n_y
    curvature[..., 0, 1] = curvature[..., 1, 0] = bend * n_x * n_y
    return curvature


def _improve(p: Array, u: Array, b: Array, scale: Array, share: Array, power: float, step: Array) -> Array:
    """Newton step where it lowers the dissipation, half a step where only that does, else none."""
    best, value = b, _dissipation(p, u, b, scale, share, power)
    for fraction in (0.5, 1.0):
        trial = b - fraction * step
        trial_value = _dissipation(p, u, trial, scale, share, power)
        better = trial_value < value
        best = np.where(better[:, None], trial, best)
        value = np.where(better, trial_value, value)
    return best


def _dissipation(p: Array, u: Array, b: Array, scale: Array, share: Array, power: float) -> Array:
    """Integral of the friction force over slip, per block, in units of the block's displacement."""
    _, size = _residuals(p, u, b)
    v = size / scale[:, None] + FRICTION_EPSILON
    if power == 1.0:
        each = v - FRICTION_EPSILON * np.log(v)
    else:
        each = v**power / power - FRICTION_EPSILON * v ** (power - 1.0) / (power - 1.0)
    return np.asarray((share * each).sum(axis=1), dtype=np.float64)


def inverse3(a: Array) -> Array:
    """Inverses (n, 3, 3) of symmetric 3x3 matrices by cofactors: ten times quicker than batched LAPACK."""
    a00, a01, a02 = a[:, 0, 0], a[:, 0, 1], a[:, 0, 2]
    a11, a12, a22 = a[:, 1, 1], a[:, 1, 2], a[:, 2, 2]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    out = np.stack([c00, c01, c02, c01, c11, c12, c02, c12, c22], axis=1)
    out /= (a00 * c00 + a01 * c01 + a02 * c02)[:, None]
    return out.reshape(-1, 3, 3)


def solve3(a: Array, rhs: Array) -> Array:
    """Solutions (n, 3) of symmetric 3x3 systems with right-hand sides (n, 3)."""
    m = inverse3(a)
    x, y, z = rhs[:, 0:1], rhs[:, 1:2], rhs[:, 2:3]
    return np.asarray(m[:, :, 0] * x + m[:, :, 1] * y + m[:, :, 2] * z, dtype=np.float64)
