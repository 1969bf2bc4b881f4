"""Body motion per block and its derivative by the parameters, for each forward model.

A parameter vector z holds x_1..4, y_1..4, r_1..4 and, with offsets, the steering zeros
d_1..4 (`WheelGeometry.vector`). With wheel vectors q that do not depend on z,
u_i = r_i R(-d_i) q_i, and the motion follows from a law of contact (`hil.robot.contact_laws`), or from a mean
for the model `paper`. Least squares is dry friction at exponent 2.

Like those of the contact laws, the functions work on numbers and on arrays (n,).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.calibration.evaluation import roll, turned_wheels
from hil.core.geometry import Array
from hil.robot.contact_laws import (
    Symmetric,
    Triple,
    continued,
    creep_balance,
    creep_stiffness,
    dissipation_slopes,
    inverse3,
    polished,
    reweighted,
    rolled_mean,
    slip,
    stiffness,
)
from hil.robot.kinematics import WheelGeometry, forward_matrix

PAPER, FRICTION, CREEP = 0, 1, 2
COLD, WARM, KNOWN = 0, 1, 2
_NEAR = 2e-3
"""Within this distance of the last parameters (m or rad) the last solution is the start."""


@dataclass(frozen=True)
class Law:
    """Law of the motion: `kind` (PAPER, FRICTION or CREEP), loads (4,), exponent, creep ratio."""

    kind: int
    load: Array
    power: float
    ratio: float

    @classmethod
    def named(cls, name: str, tyres: WheelGeometry, power: float = 1.0) -> Law:
        """Law of a forward model.

        Args:
            name: name of the forward model.
            tyres: geometry of which only the loads (`dry-friction`, `creep`) and the creep ratio are used.
            power: exponent of dry friction.
        """
        if name == "exact":
            return cls(FRICTION, np.ones(4), 2.0, 1.0)
        kinds = {"paper": PAPER, "dry-friction": FRICTION, "creep": CREEP}
        return cls(kinds[name], np.array(tyres.load), power, tyres.creep_ratio)


def solve_motion(
    kind: int, load: Array, power: float, ratio: float, z: Array, u: Array, last: Triple, start: int
) -> Triple:
    """Body motion of u (8, ...); starts from `last` if `start` is WARM, and returns `last` if KNOWN."""
    if start == KNOWN:
        return last
    if kind == PAPER:
        return mean_motion(z, u)
    scale = rolled_mean(u)
    if kind == CREEP:
        return creep_balance(z, u, scale, load, ratio)[0]
    if power == 2.0:
        return reweighted(z, u, last, scale, load, 2.0)
    if start == COLD:
        last = continued(z, u, scale, load, power)
    return polished(z, u, last, scale, load, power)


def mean_motion(z: Array, u: Array) -> Triple:
    """Body motion of wheel vectors u (8, ...) by the paper's mean velocities and K_i."""
    vx, vy, turn = 0.0 * u[0], 0.0 * u[0], 0.0 * u[0]
    for i in range(4):
        x, y = z[i], z[4 + i]
        vx, vy = vx + 0.25 * u[2 * i], vy + 0.25 * u[2 * i + 1]
        turn = turn + (x * u[2 * i + 1] - y * u[2 * i]) / (4.0 * (x * x + y * y))
    return vx, vy, turn


def motion_derivative(
    kind: int, load: Array, power: float, ratio: float, z: Array, u: Array, b: Triple, out: Array
) -> None:
    """Fill `out` (3, m), or (3, m, n) for n steps, with the derivative of the motion b by z.

    By the implicit function theorem: at b the forces P_i' f_i balance; with their derivative H by b, H db =
    -(dG/dz) dz. The scale of dry friction's smoothing is treated as fixed: its influence on the minimiser is
    of second order.
    """
    if kind == PAPER:
        mean_response(z, u, out)
        return
    scale = rolled_mean(u)
    creeping = kind == CREEP
    inverse = (
        creep_balance(z, u, scale, load, ratio)[1]
        if creeping
        else (inverse3(dissipation_slopes(z, u, b, scale, load, power)[1]))
    )
    for i in range(4):
        e = slip(z, u, b, i)
        if creeping:
            c = creep_stiffness(u[2 * i], u[2 * i + 1], scale, load[i], ratio)
            force = (c[0] * e[0] + c[1] * e[1], c[1] * e[0] + c[2] * e[1])
        else:
            weight, c = stiffness(e, scale, load[i], power)
            force = (weight * e[0], weight * e[1])
        contact_response(z, u, b[2], i, inverse, (c, e, force), creeping, out)


def contact_response(
    z: Array,
    u: Array,
    omega: Array,
    i: int,
    inverse: Symmetric,
    contact: tuple[Triple, Triple, tuple[Array, Array]],
    creeping: bool,
    out: Array,
) -> None:
    """Fill the columns of contact i in `out` (3, m, ...), from the changes of its force and lever.

    Creep stiffness belongs to the wheel: it turns with the steering zero, and weakens with the distance
    rolled, which grows with the radius. `contact` is the contact's stiffness, slip and force.
    """
    c, e, force = contact
    ux, uy, r = u[2 * i], u[2 * i + 1], z[8 + i]
    put_column(z, i, inverse, c[1] * omega, c[2] * omega, force[1], out, i)
    put_column(z, i, inverse, -c[0] * omega, -c[1] * omega, -force[0], out, 4 + i)
    mx, my = -(c[0] * ux + c[1] * uy) / r, -(c[1] * ux + c[2] * uy) / r
    if creeping:
        mx, my = mx - force[0] / r, my - force[1] / r
    put_column(z, i, inverse, mx, my, 0.0 * omega, out, 8 + i)
    if len(z) == 16:
        qx, qy = -uy, ux
        if creeping:
            qx, qy = qx - e[1], qy + e[0]
        mx, my = c[0] * qx + c[1] * qy, c[1] * qx + c[2] * qy
        if creeping:
            mx, my = mx + force[1], my - force[0]
        put_column(z, i, inverse, mx, my, 0.0 * omega, out, 12 + i)


def put_column(
    z: Array, i: int, inverse: Symmetric, mx: Array, my: Array, torque: Array, out: Array, k: int
) -> None:
    """Fill column k of `out` with the change of the motion for a change (mx, my) of contact i's force."""
    mt = z[i] * my - z[4 + i] * mx + torque
    out[0, k] = -(inverse[0] * mx + inverse[1] * my + inverse[2] * mt)
    out[1, k] = -(inverse[1] * mx + inverse[3] * my + inverse[4] * mt)
    out[2, k] = -(inverse[2] * mx + inverse[4] * my + inverse[5] * mt)


def mean_response(z: Array, u: Array, out: Array) -> None:
    """`motion_derivative` for `mean_motion`; `out` (3, m, ...)."""
    for i in range(4):
        x, y, r, ux, uy = z[i], z[4 + i], z[8 + i], u[2 * i], u[2 * i + 1]
        far = x * x + y * y
        turn = (x * uy - y * ux) / (4.0 * far)
        for axis in range(2):
            out[axis, i] = out[axis, 4 + i] = 0.0 * ux
        out[2, i] = uy / (4.0 * far) - 2.0 * x / far * turn
        out[2, 4 + i] = -ux / (4.0 * far) - 2.0 * y / far * turn
        out[0, 8 + i], out[1, 8 + i], out[2, 8 + i] = 0.25 * ux / r, 0.25 * uy / r, turn / r
        if len(z) == 16:
            out[0, 12 + i], out[1, 12 + i] = 0.25 * uy, -0.25 * ux
            out[2, 12 + i] = -(x * ux + y * uy) / (4.0 * far)


@dataclass
class Motions:
    """Motion of blocks as a function of z; caches the last solution as a start for neighbouring z.

    Attributes:
        law: law of contact.
        wheel_rad: (n, 8) raw wheel vectors, rad.
        last: (3, n) last motion.
    """

    law: Law
    wheel_rad: Array
    last: Array = field(init=False, repr=False)
    _at: Array | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.last = np.zeros((3, len(self.wheel_rad)))

    def start(self, z: Array) -> int:
        """Use of the last solution for z (m,): COLD, WARM or KNOWN; z then counts as the last parameters."""
        at, self._at = self._at, z.copy()
        if at is None or len(at) != len(z):
            return COLD
        if np.array_equal(at, z):
            return KNOWN
        return WARM if np.max(np.abs(at - z)) < _NEAR else COLD

    def motion(self, z: Array) -> Array:
        """Body displacement per block, (n, 3)."""
        self._settle(z)
        return np.ascontiguousarray(self.last.T)

    def motion_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Body displacement (n, 3) per block and its derivative (3, len(z), n)."""
        u, law = self._settle(z), self.law
        out = np.empty((3, len(z), len(self.wheel_rad)))
        motion_derivative(law.kind, law.load, law.power, law.ratio, z, u, tuple(self.last), out)
        return np.ascontiguousarray(self.last.T), out

    def _settle(self, z: Array) -> Array:
        law, u = self.law, np.empty((8, len(self.wheel_rad)))
        roll(turned_wheels(z), np.ascontiguousarray(self.wheel_rad.T), u)
        b = solve_motion(law.kind, law.load, law.power, law.ratio, z, u, tuple(self.last), self.start(z))
        self.last = np.array(b)
        return u


def make_model(name: str, wheel_rad: Array, tyres: WheelGeometry, power: float = 1.0) -> Motions:
    """Motion model by name for blocks (n, 8); arguments as for `Law.named`."""
    return Motions(Law.named(name, tyres, power), wheel_rad)


def linear_matrix(z: Array, model: str = "exact") -> Array:
    """M(z) (3, 8): map from raw wheel vectors to body displacement, for the linear models."""
    rolled = np.empty((8, 8))
    roll(turned_wheels(z), np.eye(8), rolled)
    return np.asarray(forward_matrix(z[0:4], z[4:8], model) @ rolled, dtype=np.float64)
