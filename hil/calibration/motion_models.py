"""Body motion per block and its derivative by the parameters, for each forward model.

A parameter vector z holds x_1..4, y_1..4, r_1..4 and, with offsets, the steering zeros
d_1..4 (`WheelGeometry.vector`). With wheel vectors q that do not depend on z,
u_i = r_i R(-d_i) q_i, and the motion is F(x, y) u for the linear models, for the others what the
contacts let happen (`hil.robot.contact_laws`).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np

from hil.calibration.evaluation import rolled
from hil.robot.contact_laws import (
    contact_curvature,
    contact_weight,
    creep_balance,
    creep_motion,
    creep_weights,
    displacement_scale,
    dissipation_derivatives,
    inverse3,
    least_dissipation,
    polish_dissipation,
)
from hil.robot.kinematics import WheelGeometry, forward_matrix, forward_matrix_derivative, projection
from hil.vocabulary.geometry import Array

_NEAR = 2e-3
"""Parameters closer than this (m or rad) start from the last solution."""


class MotionModel(Protocol):
    """Motion of blocks (n, 8) as a function of z (12,) or (16,)."""

    @abstractmethod
    def motion(self, z: Array) -> Array:
        """Body displacement per block, (n, 3)."""

    @abstractmethod
    def motion_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Motion (n, 3) and its derivative (n, 3, len(z))."""


class LinearModel(MotionModel):
    """`exact` and `paper`."""

    def __init__(self, name: str, wheel_rad: Array) -> None:
        self.name, self._q = name, wheel_rad

    def motion(self, z: Array) -> Array:
        """Body displacement (n, 3) by one product with the 3x8 matrix M(z)."""
        return np.asarray(self._q @ linear_matrix(z, self.name).T, dtype=np.float64)

    def motion_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Motion (n, 3) and its derivative (n, 3, m): product rule over F(x, y), r and the steering zeros."""
        u = rolled(z, self._q)
        f = forward_matrix(z[0:4], z[4:8], self.name)
        df = forward_matrix_derivative(z[0:4], z[4:8], self.name)
        jacobian = np.empty((len(u), 3, len(z)))
        jacobian[:, :, :8] = (u @ df.reshape(24, 8).T).reshape(-1, 8, 3).transpose(0, 2, 1)
        for i in range(4):
            fi, ui = f[:, 2 * i : 2 * i + 2], u[:, 2 * i : 2 * i + 2]
            jacobian[:, :, 8 + i] = ui @ fi.T / z[8 + i]
            if len(z) == 16:
                jacobian[:, :, 12 + i] = np.column_stack([ui[:, 1], -ui[:, 0]]) @ fi.T
        return u @ f.T, jacobian


def linear_matrix(z: Array, model: str = "exact") -> Array:
    """M(z) (3, 8): body displacement of raw wheel vectors, for the linear models."""
    return np.asarray(forward_matrix(z[0:4], z[4:8], model) @ rolled(z, np.eye(8)).T, dtype=np.float64)


class CreepModel(MotionModel):
    """Creep forces in balance; loads and tyres are given, not fitted.

    Args:
        wheel_rad: (n, 8) wheel vectors of the blocks, rad.
        load: (4,) relative normal loads.
        ratio: sideways over lengthwise creep stiffness.
    """

    def __init__(self, wheel_rad: Array, load: Array, ratio: float) -> None:
        self._q, self._load, self._ratio = wheel_rad, load, ratio

    def motion(self, z: Array) -> Array:
        """Body displacement (n, 3) by weighted least squares, each block with its own weights."""
        return creep_motion(projection(z[0:4], z[4:8]), rolled(z, self._q), self._load, self._ratio)

    def motion_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Motion (n, 3) and its derivative (n, 3, m), implicit from the balance sum_i P_i' W_i e_i = 0.

        W follows the wheel: it turns with the zero and weakens with the way rolled, as the radius grows.
        """
        p, u = projection(z[0:4], z[4:8]), rolled(z, self._q)
        wxx, wxy, wyy = weights = creep_weights(u, self._load, self._ratio)
        b, inverse = creep_balance(p, u, weights)
        slip = u - b @ p.T
        ex, ey, ux, uy = slip[:, 0::2], slip[:, 1::2], u[:, 0::2], u[:, 1::2]
        fx, fy = wxx * ex + wxy * ey, wxy * ex + wyy * ey
        omega, r = b[:, 2:3], z[8:12]
        moves = [(-wxy * omega, -wyy * omega), (wxx * omega, wxy * omega)]
        moves.append(((wxx * ux + wxy * uy - fx) / r, (wxy * ux + wyy * uy - fy) / r))
        if len(z) == 16:
            qx, qy = uy - ey, ex - ux
            moves.append((wxx * qx + wxy * qy + fy, wxy * qx + wyy * qy - fx))
        return b, np.matmul(inverse, _wrench_derivative(z, moves, fx, fy))


class DryFrictionModel(MotionModel):
    """Least dissipation; warm-started, since a fit asks for neighbouring z one after the other.

    Args:
        wheel_rad: (n, 8) wheel vectors of the blocks, rad.
        load: (4,) relative normal loads; given, not fitted.
        power: exponent of the law.
    """

    def __init__(self, wheel_rad: Array, load: Array, power: float = 1.0) -> None:
        self._q, self._load, self._power = wheel_rad, load, power
        self._moving = np.any(wheel_rad != 0.0, axis=1)
        self._last: tuple[Array, Array] | None = None

    def motion(self, z: Array) -> Array:
        """Body displacement (n, 3) by Newton from a near last solution, else the full continuation."""
        out = np.zeros((len(self._q), 3))
        out[self._moving] = self._solve(z)[0]
        return out

    def _solve(self, z: Array) -> tuple[Array, Array, Array, Array]:
        u = rolled(z, self._q[self._moving])
        p, scale = projection(z[0:4], z[4:8]), displacement_scale(u)
        last = self._last
        if last is not None and np.array_equal(last[0], z):
            b = last[1]
        elif last is not None and np.max(np.abs(last[0] - z)) < _NEAR:
            b = polish_dissipation(p, u, last[1], scale, self._load, power=self._power)
        else:
            b = least_dissipation(p, u, self._load, power=self._power)
        self._last = (z.copy(), b)
        return b, u, p, scale

    def motion_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Implicit derivative: H db = -(dG/dz) dz at the stationary point G(b, z) = 0."""
        b, u, p, scale = self._solve(z)
        e = (b @ p.T - u).reshape(-1, 4, 2)
        size = np.sqrt(np.einsum("nij,nij->ni", e, e))
        _, hessian = dissipation_derivatives(p, u, b, scale, self._load, self._power)
        weight = contact_weight(size, scale, self._load, self._power)
        curvature = contact_curvature(e, size, scale, self._load, self._power)
        pull = _pull(z, b, u.reshape(-1, 4, 2), e * weight[..., None], curvature)
        motion, jacobian = np.zeros((len(self._q), 3)), np.zeros((len(self._q), 3, len(z)))
        motion[self._moving] = b
        jacobian[self._moving] = -np.matmul(inverse3(hessian), pull)
        return motion, jacobian


def _pull(z: Array, b: Array, u: Array, force: Array, curvature: Array) -> Array:
    """Derivative (n, 3, len(z)) of the dissipation's gradient by z at fixed motion b.

    The smoothing scale is treated as fixed: its influence on the minimiser is of second order.

    Args:
        z: parameter vector.
        b: (n, 3) body motion.
        u: (n, 4, 2) wheel vectors.
        force: (n, 4, 2) of each contact.
        curvature: (n, 4, 2, 2) its derivative by the slip.
    """
    omega, zero = np.broadcast_to(b[:, 2:3], force.shape[:2]), np.zeros(force.shape[:2])
    slips = [
        np.stack([zero, omega], axis=-1),
        np.stack([-omega, zero], axis=-1),
        -u / z[8:12, None],
    ]
    if len(z) == 16:
        slips.append(np.stack([-u[..., 1], u[..., 0]], axis=-1))
    moved = [np.einsum("niab,nib->nia", curvature, slip) for slip in slips]
    moves = [(m[..., 0], m[..., 1]) for m in moved]
    return _wrench_derivative(z, moves, force[..., 0], force[..., 1])


def _wrench_derivative(z: Array, moves: list[tuple[Array, Array]], fx: Array, fy: Array) -> Array:
    """Derivative (n, 3, len(z)) of the contacts' total force and torque by z.

    Args:
        z: parameter vector; its x and y are the levers.
        moves: change of each contact's force (n, 4), (n, 4) by x, y, r and the zeros, in turn.
        fx: (n, 4) forces themselves, whose levers x and y change, and
        fy: (n, 4).
    """
    out = np.empty((len(fx), 3, len(z)))
    for k, (mx, my) in enumerate(moves):
        columns = slice(4 * k, 4 * k + 4)
        out[:, 0, columns], out[:, 1, columns] = mx, my
        out[:, 2, columns] = -z[4:8] * mx + z[0:4] * my
    out[:, 2, 0:4] += fy
    out[:, 2, 4:8] -= fx
    return out


def make_model(name: str, wheel_rad: Array, tyres: WheelGeometry, power: float = 1.0) -> MotionModel:
    """Motion model by name for blocks (n, 8).

    Args:
        name: forward model.
        wheel_rad: (n, 8) raw wheel vectors.
        tyres: loads, which `dry-friction` and `creep` ask for, and creep ratio; its wheel parameters do not
            count.
        power: exponent of the dry-friction law.
    """
    if name == "dry-friction":
        return DryFrictionModel(wheel_rad, tyres.load, power)
    if name == "creep":
        return CreepModel(wheel_rad, tyres.load, tyres.creep_ratio)
    return LinearModel(name, wheel_rad)
