"""Body motion per block and its derivative by the parameters, for each forward model.

A parameter vector z holds x_1..4, y_1..4, r_1..4 and, with offsets, the steering zeros
d_1..4 (`WheelGeometry.vector`). With wheel vectors q that do not depend on z,
u_i = r_i R(-d_i) q_i, and the motion is what the contacts let happen (`hil.robot.contact_laws`), for the
model `paper` a mean. Least squares is dry friction at exponent 2.

The functions are written for numbers and for arrays (n,) alike, as those of the contact laws are.
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
"""Parameters closer than this (m or rad) start from the last solution."""


@dataclass(frozen=True)
class Law:
    """What decides the motion: `kind` (PAPER, FRICTION or CREEP), loads (4,), exponent, tyre ratio."""

    kind: int
    load: Array
    power: float
    ratio: float

    @classmethod
    def named(cls, name: str, tyres: WheelGeometry, power: float = 1.0) -> Law:
        """The law of a forward model.

        Args:
            name: of the model.
            tyres: loads, which `dry-friction` and `creep` ask for, and creep ratio; its wheel parameters do
                not count.
            power: exponent of dry friction.
        """
        if name == "exact":
            return cls(FRICTION, np.ones(4), 2.0, 1.0)
        kinds = {"paper": PAPER, "dry-friction": FRICTION, "creep": CREEP}
        return cls(kinds[name], np.array(tyres.load), power, tyres.creep_ratio)


def settled(
    kind: int, load: Array, power: float, ratio: float, z: Array, u: Array, last: Triple, start: int
) -> Triple:
    """Body motion of u (8, ...), from a last solution where `start` is WARM, or that itself if KNOWN."""
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
    """The paper's mean velocities and K_i, of wheel vectors u (8, ...)."""
    vx, vy, turn = 0.0 * u[0], 0.0 * u[0], 0.0 * u[0]
    for i in range(4):
        x, y = z[i], z[4 + i]
        vx, vy = vx + 0.25 * u[2 * i], vy + 0.25 * u[2 * i + 1]
        turn = turn + (x * u[2 * i + 1] - y * u[2 * i]) / (4.0 * (x * x + y * y))
    return vx, vy, turn


def respond(
    kind: int, load: Array, power: float, ratio: float, z: Array, u: Array, b: Triple, out: Array
) -> None:
    """Put the derivative of the motion b by z in place: `out` (3, m), or (3, m, n) for n steps.

    Implicit: at b the forces P_i' f_i balance, and with their slope H, H db = -(dG/dz) dz. The scale of dry
    friction's smoothing is treated as fixed: its influence on the minimiser is of second order.
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
    """Columns of contact i in `out` (3, m, ...): its force changes with its slip, its torque by its lever.

    Creep stiffness follows the wheel: it turns with the zero and weakens with the way rolled, as the radius
    grows. `contact` is its stiffness, slip and force.
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
    """Put the change of the motion in place when the force of contact i changes by (mx, my)."""
    mt = z[i] * my - z[4 + i] * mx + torque
    out[0, k] = -(inverse[0] * mx + inverse[1] * my + inverse[2] * mt)
    out[1, k] = -(inverse[1] * mx + inverse[3] * my + inverse[4] * mt)
    out[2, k] = -(inverse[2] * mx + inverse[4] * my + inverse[5] * mt)


def mean_response(z: Array, u: Array, out: Array) -> None:
    """As `respond`, for `mean_motion`; `out` (3, m, ...)."""
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
    """Motion of blocks as a function of z; it remembers the last one, since a fit asks for neighbouring z.

    Attributes:
        law: of the contacts.
        wheel_rad: (n, 8) raw wheel vectors, rad.
        last: (3, n) the last motion.
    """

    law: Law
    wheel_rad: Array
    last: Array = field(init=False, repr=False)
    _at: Array | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.last = np.zeros((3, len(self.wheel_rad)))

    def start(self, z: Array) -> int:
        """What the last solution is worth at z (m,): COLD, WARM or KNOWN. From now on it is that of z."""
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
        """Motion (n, 3) and its derivative (3, len(z), n)."""
        u, law = self._settle(z), self.law
        out = np.empty((3, len(z), len(self.wheel_rad)))
        respond(law.kind, law.load, law.power, law.ratio, z, u, tuple(self.last), out)
        return np.ascontiguousarray(self.last.T), out

    def _settle(self, z: Array) -> Array:
        law, u = self.law, np.empty((8, len(self.wheel_rad)))
        roll(turned_wheels(z), np.ascontiguousarray(self.wheel_rad.T), u)
        b = settled(law.kind, law.load, law.power, law.ratio, z, u, tuple(self.last), self.start(z))
        self.last = np.array(b)
        return u


def make_model(name: str, wheel_rad: Array, tyres: WheelGeometry, power: float = 1.0) -> Motions:
    """Motion model by name for blocks (n, 8); arguments as for `Law.named`."""
    return Motions(Law.named(name, tyres, power), wheel_rad)


def linear_matrix(z: Array, model: str = "exact") -> Array:
    """M(z) (3, 8): body displacement of raw wheel vectors, for the linear models."""
    rolled = np.empty((8, 8))
    roll(turned_wheels(z), np.eye(8), rolled)
    return np.asarray(forward_matrix(z[0:4], z[4:8], model) @ rolled, dtype=np.float64)
