"""Laws of wheel contact: body motion of a robot whose wheels contradict each other.

No set of four wheels agrees exactly on a body motion b: P b = u (`hil.robot.kinematics`) has eight rows and
three unknowns. The remainder is slip e_i = P_i b - u_i. Two laws:

* dry friction: each contact resists with a force that grows with its load N_i and not with slip; least
  dissipation, b = argmin sum_i N_i |e_i|.
  Explains large contradictions, and the authors' recordings, best (`docs/calibration.md`).
* creep: a rolling tyre under a side force drifts in proportion to it, force = C N_i e_i / |u_i|, with C
  smaller sideways than lengthwise (normal loads N_i). Explains small contradictions, as between wheels whose
  zeros are a degree off; the forces balance at a weighted least-squares motion.

Forces along a wheel count like those across it: its servo holds the measured rotation.

`creep_motion` and `least_dissipation` take rows of wheel vectors. The functions below them work for one row
and for many: a quantity is a number, or an array (n,) with one number per row; wheel vectors u are (8,) or
(8, n). numba compiles them for numbers (`hil.calibration.residual_pass`), numpy runs them on arrays. Wheel
positions are the first eight elements of a parameter vector z: x_1..4, y_1..4, m. A symmetric 3x3 matrix is
(xx, xy, xt, yy, yt, tt).
"""

from typing import TypeAlias

import numpy as np

from hil.core.geometry import Array

FRICTION_EPSILON = 2e-3
LEAST_ROLLED = 0.05
_POWERS = (2.0, 1.5, 1.2, 1.0)
_ITERATIONS = (1, 3, 3, 8)
_LEAST = 1e-30
_TIE = 1e-15
_SETTLED, _ARM = 1e-8, 0.1

Triple: TypeAlias = tuple[Array, Array, Array]
Symmetric: TypeAlias = tuple[Array, Array, Array, Array, Array, Array]


def creep_motion(p: Array, u: Array, load: Array, ratio: float) -> Array:
    """Body motion (n, 3) of wheel vectors (n, 8) on creeping tyres.

    Args:
        p: (8, 3) from `hil.robot.kinematics.projection`.
        u: (n, 8) wheel vectors.
        load: (4,) relative normal loads.
        ratio: sideways over lengthwise creep stiffness.
    """
    columns = np.ascontiguousarray(u.T)
    return np.stack(creep_balance(positions(p), columns, rolled_mean(columns), load, ratio)[0], axis=1)


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
    columns, z = np.ascontiguousarray(u.T), positions(p)
    scale, share = rolled_mean(columns), np.ones(4) if load is None else np.asarray(load, dtype=np.float64)
    b = continued(z, columns, scale, share, power)
    return np.stack(polished(z, columns, b, scale, share, power), axis=1)


def positions(p: Array) -> Array:
    """Wheel positions (8,), x_1..4 and y_1..4, that belong to a projection P (8, 3)."""
    return np.concatenate([p[1::2, 2], -p[0::2, 2]])


def rolled_mean(u: Array) -> Array:
    """Mean wheel displacement (or speed), above 0, of wheel vectors u (8, ...); the scale of the slip."""
    total = 0.0 * u[0]
    for i in range(4):
        total = total + np.sqrt(u[2 * i] * u[2 * i] + u[2 * i + 1] * u[2 * i + 1])
    mean: Array = 0.25 * total + 1e-9
    return mean


def slip(z: Array, u: Array, b: Triple, i: int) -> Triple:
    """Slip (e_x, e_y, |e|) of contact i at body motion b."""
    ex = b[0] - z[4 + i] * b[2] - u[2 * i]
    ey = b[1] + z[i] * b[2] - u[2 * i + 1]
    return ex, ey, np.sqrt(ex * ex + ey * ey)


def friction(relative: Array, share: Array, power: float) -> Array:
    """Friction force per slip of a contact, from its slip relative to the scale; a number or (n,).

    Args:
        relative: slip over `rolled_mean`.
        share: relative normal load.
        power: exponent q of `least_dissipation`.
    """
    size = relative + FRICTION_EPSILON
    return share / size if power == 1.0 else share / size * raised(size, power - 1.0)


def raised(size: Array, exponent: float) -> Array:
    """Power of `size`, a number or (n,); fast for the exponents 0.5 and 1."""
    if exponent == 0.5:
        return np.sqrt(size)
    if exponent == 1.0:
        return size
    return np.exp(exponent * np.log(size))


def stiffness(e: Triple, scale: Array, share: Array, power: float) -> tuple[Array, Triple]:
    """Force per slip of a contact with slip e, and second derivative (xx, xy, yy) of the dissipation."""
    relative, length = e[2] / scale, np.maximum(e[2], _LEAST)
    weight = friction(relative, share, power)
    bend = (power - 2.0) * weight * relative / (relative + FRICTION_EPSILON)
    nx, ny = e[0] / length, e[1] / length
    return weight, (weight + bend * nx * nx, bend * nx * ny, weight + bend * ny * ny)


def reweighted(z: Array, u: Array, b: Triple, scale: Array, share: Array, power: float) -> Triple:
    """Weighted least squares of wheel vectors u (8, ...), with weights from the friction at motion b.

    Forces and torques decouple about the weighted centre of the contacts.
    """
    total, sx, sy, srr = 0.0 * scale, 0.0 * scale, 0.0 * scale, 0.0 * scale
    fx, fy, ft = 0.0 * scale, 0.0 * scale, 0.0 * scale
    for i in range(4):
        x, y, ux, uy = z[i], z[4 + i], u[2 * i], u[2 * i + 1]
        w = friction(slip(z, u, b, i)[2] / scale, share[i], power)
        total, sx, sy, srr = total + w, sx + w * x, sy + w * y, srr + w * (x * x + y * y)
        fx, fy, ft = fx + w * ux, fy + w * uy, ft + w * (x * uy - y * ux)
    turn = (ft + (sy * fx - sx * fy) / total) / np.maximum(srr - (sx * sx + sy * sy) / total, _LEAST)
    return (fx + sy * turn) / total, (fy - sx * turn) / total, turn


def continued(z: Array, u: Array, scale: Array, share: Array, power: float) -> Triple:
    """Body motion of u (8, ...) near least dissipation at exponent `power`, without a start value."""
    b = (0.0 * scale, 0.0 * scale, 0.0 * scale)
    for stage in range(len(_POWERS)):
        if _POWERS[stage] >= power:
            for _ in range(_ITERATIONS[stage]):
                b = reweighted(z, u, b, scale, share, _POWERS[stage])
    return b


def polished(
    z: Array, u: Array, b: Triple, scale: Array, share: Array, power: float, steps: int = 3
) -> Triple:
    """Newton steps on the smoothed dissipation of u (8, ...) from a motion b that is already close.

    Each step is taken in full where that lowers the dissipation, by half where that lowers it more, else not
    at all. A tie goes to the full step, so that rounding decides nothing near the minimum. A negligible step
    ends the iteration.
    """
    here = dissipation(z, u, b, scale, share, power)
    for _ in range(steps):
        gradient, hessian = dissipation_slopes(z, u, b, scale, share, power)
        step = times(inverse3(hessian), gradient)
        if np.all(np.abs(step[0]) + np.abs(step[1]) + _ARM * np.abs(step[2]) < _SETTLED * scale):
            return stepped(b, step, 1.0 + 0.0 * scale)
        at_half = dissipation(z, u, stepped(b, step, 0.5 + 0.0 * scale), scale, share, power)
        at_full = dissipation(z, u, stepped(b, step, 1.0 + 0.0 * scale), scale, share, power)
        halved, lower = at_half < here, np.minimum(here, at_half)
        full = at_full <= lower + _TIE
        fraction: Array = 1.0 * full + 0.5 * halved * (1.0 - full)  # type: ignore[assignment]
        b = stepped(b, step, fraction)
        here = np.minimum(lower, at_full)
    return b


def stepped(b: Triple, step: Triple, fraction: Array) -> Triple:
    """The motion b minus `fraction` times a step, each number or (n,)."""
    return b[0] - fraction * step[0], b[1] - fraction * step[1], b[2] - fraction * step[2]


def dissipation(z: Array, u: Array, b: Triple, scale: Array, share: Array, power: float) -> Array:
    """Integral of the friction force over the slip of u (8, ...) at b, in units of the squared scale."""
    total = 0.0 * scale
    for i in range(4):
        v = slip(z, u, b, i)[2] / scale + FRICTION_EPSILON
        if power == 1.0:
            each = v - FRICTION_EPSILON * np.log(v)
        else:
            each = raised(v, power - 1.0) * (v / power - FRICTION_EPSILON / (power - 1.0))
        total = total + share[i] * each
    return total


def dissipation_slopes(
    z: Array, u: Array, b: Triple, scale: Array, share: Array, power: float
) -> tuple[Triple, Symmetric]:
    """Gradient and Hessian (3x3) of the smoothed dissipation by the motion b."""
    gx, gy, gt = 0.0 * scale, 0.0 * scale, 0.0 * scale
    hessian = (gx, gx, gx, gx, gx, gx)
    for i in range(4):
        e = slip(z, u, b, i)
        weight, curvature = stiffness(e, scale, share[i], power)
        fx, fy = weight * e[0], weight * e[1]
        gx, gy, gt = gx + fx, gy + fy, gt + z[i] * fy - z[4 + i] * fx
        hessian = with_contact(hessian, curvature, z[i], z[4 + i])
    return (gx, gy, gt), hessian


def with_contact(total: Symmetric, contact: Triple, x: Array, y: Array) -> Symmetric:
    """Sum of `total` and P_i' C P_i for a contact at (x, y) with stiffness C = (xx, xy, yy)."""
    xx, xy, yy = contact
    tx, ty = x * xy - y * xx, x * yy - y * xy
    return (
        total[0] + xx,
        total[1] + xy,
        total[2] + tx,
        total[3] + yy,
        total[4] + ty,
        total[5] + x * ty - y * tx,
    )


def creep_stiffness(ux: Array, uy: Array, scale: Array, load: Array, ratio: float) -> Triple:
    """Creep force per slip (xx, xy, yy), body frame, of a contact whose wheel rolls by (ux, uy).

    A wheel that hardly rolls counts as if it rolled a twentieth of the mean, so that the result stays finite.

    Args:
        ux: displacement ahead in the body frame.
        uy: displacement to the left.
        scale: `rolled_mean` of all wheels.
        load: relative normal load.
        ratio: sideways over lengthwise creep stiffness.
    """
    size = np.sqrt(ux * ux + uy * uy)
    weight = load / np.maximum(size / scale, LEAST_ROLLED)
    length = np.maximum(size, _LEAST)
    nx, ny = ux / length, uy / length
    bend, plain = (1.0 - ratio) * weight, ratio * weight
    return plain + bend * nx * nx, bend * nx * ny, plain + bend * ny * ny


def creep_balance(z: Array, u: Array, scale: Array, load: Array, ratio: float) -> tuple[Triple, Symmetric]:
    """Body motion of u (8, ...) at which creep forces balance, and the inverse (3x3) of their stiffness."""
    fx, fy, ft = 0.0 * scale, 0.0 * scale, 0.0 * scale
    slope = (fx, fx, fx, fx, fx, fx)
    for i in range(4):
        ux, uy = u[2 * i], u[2 * i + 1]
        xx, xy, yy = creep_stiffness(ux, uy, scale, load[i], ratio)
        push_x, push_y = xx * ux + xy * uy, xy * ux + yy * uy
        fx, fy, ft = fx + push_x, fy + push_y, ft + z[i] * push_y - z[4 + i] * push_x
        slope = with_contact(slope, (xx, xy, yy), z[i], z[4 + i])
    inverse = inverse3(slope)
    return times(inverse, (fx, fy, ft)), inverse


def inverse3(a: Symmetric) -> Symmetric:
    """Inverse of a symmetric positive definite 3x3 matrix by cofactors."""
    xx, xy, xt, yy, yt, tt = a
    c0, c1, c2 = yy * tt - yt * yt, xt * yt - xy * tt, xy * yt - xt * yy
    over = 1.0 / np.maximum(xx * c0 + xy * c1 + xt * c2, _LEAST)
    return (
        c0 * over,
        c1 * over,
        c2 * over,
        (xx * tt - xt * xt) * over,
        (xt * xy - xx * yt) * over,
        (xx * yy - xy * xy) * over,
    )


def times(a: Symmetric, v: Triple) -> Triple:
    """Product of a symmetric 3x3 matrix with a vector."""
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2],
        a[1] * v[0] + a[3] * v[1] + a[4] * v[2],
        a[2] * v[0] + a[4] * v[1] + a[5] * v[2],
    )
