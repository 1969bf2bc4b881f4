"""How a body moves whose wheels contradict each other: the law of the contacts decides.

No set of four wheels agrees exactly on a body motion b: P b = u (`hil.robot.kinematics`) has eight rows and
three unknowns, and what is left over is slip e_i = u_i - P_i b. Two laws:

* dry friction: each contact resists with a force that grows with its load N_i and not with slip; least
  dissipation, b = argmin sum_i N_i |e_i|.
  Explains large contradictions, and the authors' recordings, best (`docs/calibration.md`).
* creep: a rolling tyre that is pushed drifts in proportion, force = C N_i e_i / |u_i|, with C smaller
  sideways than lengthwise (normal loads N_i). Small contradictions, as
  between wheels whose zeros are a degree off; the forces balance at a weighted least-squares motion.

Forces along a wheel count like those across: its servo holds the rotation that is measured.
"""

from __future__ import annotations

import numpy as np

from hil.vocabulary.geometry import Array

FRICTION_EPSILON = 2e-3
LEAST_ROLLED = 0.05
_POWERS = (2.0, 1.5, 1.2, 1.0)
_ITERATIONS = (1, 3, 3, 8)


def creep_weights(u: Array, load: Array, ratio: float) -> tuple[Array, Array, Array]:
    """Force per slip of each contact in the body frame: entries xx, xy, yy of a matrix, (n, 4) each.

    A wheel that hardly rolls counts as if it rolled a twentieth of the mean, so that it stays finite.

    Args:
        u: (n, 8) wheel vectors.
        load: (4,) relative normal loads.
        ratio: sideways over lengthwise creep stiffness.
    """
    ux, uy = u[:, 0::2], u[:, 1::2]
    size = np.hypot(ux, uy)
    weight = load / np.maximum(size / displacement_scale(u)[:, None], LEAST_ROLLED)
    safe = np.maximum(size, 1e-30)
    nx, ny = ux / safe, uy / safe
    bend = (1.0 - ratio) * weight
    plain = ratio * weight
    return plain + bend * nx * nx, bend * nx * ny, plain + bend * ny * ny


def creep_balance(p: Array, u: Array, weights: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Body motion (n, 3) at which the creep forces balance, and the inverse (n, 3, 3) of their slope.

    Args:
        p: (8, 3) from `hil.robot.kinematics.projection`.
        u: (n, 8) wheel vectors, m or m/s.
        weights: (n, 4) each, from `creep_weights`.
    """
    wxx, wxy, wyy = weights
    ux, uy, rx, ry = u[:, 0::2], u[:, 1::2], p[0::2, 2], p[1::2, 2]
    tx, ty = wxx * rx + wxy * ry, wxy * rx + wyy * ry
    slope = np.empty((len(u), 3, 3))
    slope[:, 0, 0], slope[:, 1, 1] = wxx.sum(axis=1), wyy.sum(axis=1)
    slope[:, 0, 1] = slope[:, 1, 0] = wxy.sum(axis=1)
    slope[:, 0, 2] = slope[:, 2, 0] = tx.sum(axis=1)
    slope[:, 1, 2] = slope[:, 2, 1] = ty.sum(axis=1)
    slope[:, 2, 2] = tx @ rx + ty @ ry
    fx, fy = wxx * ux + wxy * uy, wxy * ux + wyy * uy
    push = np.stack([fx.sum(axis=1), fy.sum(axis=1), fx @ rx + fy @ ry], axis=1)
    inverse = inverse3(slope)
    return np.asarray(np.matmul(inverse, push[..., None])[..., 0], dtype=np.float64), inverse


def creep_motion(p: Array, u: Array, load: Array, ratio: float) -> Array:
    """Body motion (n, 3) of wheel vectors (n, 8) on creeping tyres.

    Args:
        p: (8, 3) from `hil.robot.kinematics.projection`.
        u: (n, 8) wheel vectors.
        load: (4,) relative normal loads.
        ratio: sideways over lengthwise creep stiffness.
    """
    return creep_balance(p, u, creep_weights(u, load, ratio))[0]


def least_dissipation(p: Array, u: Array, load: Array | None = None, power: float = 1.0) -> Array:
    """Body motion (n, 3) that dissipates least against dry friction at four contacts.

    Minimises sum_i load_i psi(|P_i b - u_i|) with psi' (e) = e (e / s + eps)^(q - 2), the smoothed
    Coulomb friction at q = 1, s the block's mean wheel displacement. Iteratively reweighted least
    squares continued over q = 2, 1.5, 1.2, 1, then Newton steps.

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
    """Newton steps on the smoothed dissipation from a start b (n, 3) that is already close.

    Args:
        p: (8, 3) from `hil.robot.kinematics.projection`.
        u: (n, 8) wheel vectors, m or m/s.
        b: (n, 3) body motion to start from.
        scale: (n,) from `displacement_scale`.
        share: (4,) relative normal loads.
        power: exponent q of `least_dissipation`.
        steps: how many.
    """
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
    """Weight (n, 4) of each contact: friction force per slip, from slip sizes (n, 4).

    Args:
        size: (n, 4) slip, m or m/s.
        scale: (n,) from `displacement_scale`.
        share: (4,) relative normal loads.
        power: exponent q of `least_dissipation`.
    """
    return np.asarray(share * (size / scale[:, None] + FRICTION_EPSILON) ** (power - 2.0), dtype=np.float64)


def _reweighted(p: Array, u: Array, b: Array, scale: Array, share: Array, power: float) -> Array:
    _, size = _residuals(p, u, b)
    wide = np.repeat(contact_weight(size, scale, share, power), 2, axis=1)
    products = (p[:, :, None] * p[:, None, :]).reshape(8, 9)
    return solve3((wide @ products).reshape(-1, 3, 3), (wide * u) @ p)


def dissipation_derivatives(
    p: Array, u: Array, b: Array, scale: Array, share: Array, power: float = 1.0
) -> tuple[Array, Array]:
    """Gradient (n, 3) and Hessian (n, 3, 3) of the smoothed dissipation by the motion b.

    Args:
        p: (8, 3) from `hil.robot.kinematics.projection`.
        u: (n, 8) wheel vectors, m or m/s.
        b: (n, 3) body motion.
        scale: (n,) from `displacement_scale`.
        share: (4,) relative normal loads.
        power: exponent q of `least_dissipation`.
    """
    e, size = _residuals(p, u, b)
    curvature = contact_curvature(e, size, scale, share, power)
    blocks = p.reshape(4, 2, 3)
    weight = contact_weight(size, scale, share, power)
    gradient = (np.repeat(weight, 2, axis=1) * e.reshape(-1, 8)) @ p
    products = np.einsum("iab,icd->iacbd", blocks, blocks).reshape(16, 9)
    return gradient, (curvature.reshape(-1, 16) @ products).reshape(-1, 3, 3)


def contact_curvature(e: Array, size: Array, scale: Array, share: Array, power: float = 1.0) -> Array:
    """Second derivative (n, 4, 2, 2) of each contact's dissipation by its slip e (n, 4, 2).

    Args:
        e: (n, 4, 2) slip in the body frame.
        size: (n, 4) its length.
        scale: (n,) from `displacement_scale`.
        share: (4,) relative normal loads.
        power: exponent q of `least_dissipation`.
    """
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
