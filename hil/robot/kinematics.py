"""Maps between body motion and wheel motion of a robot with four steered and driven wheels.

Rigid-body constraint of wheel i at (x_i, y_i): its contact point moves with
(v_x - y_i w, v_y + x_i w) in the body frame (arXiv 2509.04016, equation 1). Stacked over
the wheels this is P b = u with P (8, 3), body twist b = (v_x, v_y, w) and wheel vectors
u = (v_1 cos d_1, v_1 sin d_1, v_2 cos d_2, ...). Forward models, by name:

* `exact`: least squares, b = pinv(P) u, for any wheel positions.
* `paper`: the paper's mean velocities and K_i; equals `exact` only for the centred square robot.
* `dry-friction`, `creep`: wheels that contradict each other slip by a law of contact
  (`hil.robot.contact_laws`).

SI units; wheel order FL, BL, BR, FR; leading axes of wheel arrays are batch axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array, ArrayLike
from hil.robot.contact_laws import creep_motion, least_dissipation

ForwardModel = Literal["exact", "paper", "dry-friction", "creep"]
MODELS: tuple[str, ...] = get_args(ForwardModel)

NOMINAL_HALF_BASE_M = 0.1125
NOMINAL_RADIUS_M = 0.0254


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
        steering_zero_rad: zero to subtract from a measured steering angle to get the wheel's heading.
        load: normal loads relative to their mean; used by `dry-friction` and `creep`.
        creep_ratio: sideways over lengthwise creep stiffness of the tyres; used by `creep` only.
    """

    x_m: Array
    y_m: Array
    radius_m: Array
    steering_zero_rad: Array = field(default_factory=lambda: np.zeros(4))
    load: Array = field(default_factory=lambda: np.ones(4))
    creep_ratio: float = 1.0

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m", "radius_m", "steering_zero_rad", "load"):
            object.__setattr__(self, name, _four(getattr(self, name)))
        if np.any(self.radius_m <= 0):
            raise UsageError(f"wheel radii {self.radius_m.tolist()} m", expected="all positive")
        if np.any(self.load < 0) or not np.any(self.load > 0):
            raise UsageError(f"wheel loads {self.load.tolist()}", expected="none negative, some positive")
        if not 0 < self.creep_ratio < np.inf:
            raise UsageError(f"creep ratio {self.creep_ratio}", expected="a finite number above 0")
        if np.linalg.matrix_rank(self.projection()) < 3:
            raise UsageError("all wheels are at one point: the turn rate cannot be measured")

    @classmethod
    def nominal(cls) -> WheelGeometry:
        """The CAD geometry (arXiv 2509.04016): +-112.5 mm, radius 25.4 mm."""
        a = NOMINAL_HALF_BASE_M
        return cls(np.array([a, -a, -a, a]), np.array([a, a, -a, -a]), np.full(4, NOMINAL_RADIUS_M))

    @classmethod
    def from_vector(cls, z: ArrayLike) -> WheelGeometry:
        """Geometry of a parameter vector (12,) or (16,): x, y, radius and, in the latter, steering zeros."""
        v = np.asarray(z, dtype=np.float64)
        return cls(v[0:4], v[4:8], v[8:12], v[12:16] if v.size == 16 else np.zeros(4))

    def with_vector(self, z: ArrayLike) -> WheelGeometry:
        """Geometry of another parameter vector (12,) or (16,), with the same tyres and loads."""
        return self.from_vector(z).with_tyres(self.load, self.creep_ratio)

    def with_tyres(self, load: ArrayLike, creep_ratio: float) -> WheelGeometry:
        """The same wheels with other loads (4,) and another creep ratio."""
        return replace(self, load=_four(load), creep_ratio=creep_ratio)

    def tyres(self) -> dict[str, object]:
        """Loads and creep ratio as plain data, for files; keyword arguments of `with_tyres`."""
        return {"load": self.load.tolist(), "creep_ratio": self.creep_ratio}

    def vector(self) -> Array:
        """Parameter vector (16,): x, y, radius, steering zero."""
        return np.concatenate([self.x_m, self.y_m, self.radius_m, self.steering_zero_rad])

    def to_json(self) -> dict[str, list[float]]:
        """The parameters under their names in files and results, each (4,), m and rad."""
        return {
            "x_w_m": self.x_m.tolist(),
            "y_w_m": self.y_m.tolist(),
            "r_m": self.radius_m.tolist(),
            "delta0_rad": self.steering_zero_rad.tolist(),
        }

    def projection(self) -> Array:
        """P, shape (8, 3), read-only: rows (v_x, v_y) of wheels 1..4 in turn."""
        return self._projection

    @cached_property
    def _projection(self) -> Array:
        found = projection(self.x_m, self.y_m)
        found.setflags(write=False)
        return found


def projection(x_m: ArrayLike, y_m: ArrayLike) -> Array:
    """P (8, 3) for contact points x (4,), y (4,): maps a body twist to wheel vectors."""
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
    """Wheel speeds (..., 4) m/s, never negative, and steering angles (..., 4) rad for twists (..., 3).

    The angles include the steering zeros, as measured angles do. A wheel at rest gets its zero.
    """
    u = np.asarray(twist_body, dtype=np.float64).dot(geometry.projection().T)
    ux, uy = u[..., 0::2], u[..., 1::2]
    return np.hypot(ux, uy), np.arctan2(uy, ux) + geometry.steering_zero_rad


def forward(
    geometry: WheelGeometry, wheel_speed_m_s: ArrayLike, steering_rad: ArrayLike, model: str = "exact"
) -> Array:
    """Body twist (..., 3) from signed wheel speeds (..., 4) m/s and measured steering angles (..., 4) rad.

    Args:
        geometry: wheel parameters.
        wheel_speed_m_s: (..., 4) signed rolling speeds, m/s.
        steering_rad: (..., 4) measured steering angles, rad.
        model: name of the forward model.
    """
    u = wheel_vectors(wheel_speed_m_s, np.asarray(steering_rad) - geometry.steering_zero_rad)
    return twist_of_vectors(geometry, u, model)


def twist_of_vectors(geometry: WheelGeometry, u: Array, model: str = "exact") -> Array:
    """Body motion (..., 3) from wheel vectors (..., 8), in m/s or in m per step.

    Args:
        geometry: wheel parameters.
        u: (..., 8) wheel vectors.
        model: name of the forward model.
    """
    if model not in ("dry-friction", "creep"):
        return np.asarray(u @ forward_matrix(geometry.x_m, geometry.y_m, model).T, dtype=np.float64)
    flat, p = np.ascontiguousarray(u.reshape(-1, 8)), geometry.projection()
    if model == "creep":
        motion = creep_motion(p, flat, geometry.load, geometry.creep_ratio)
    else:
        motion = least_dissipation(p, flat, geometry.load)
    return motion.reshape(*u.shape[:-1], 3)


def forward_matrix(x_m: ArrayLike, y_m: ArrayLike, model: str = "exact") -> Array:
    """Linear forward map (3, 8) from wheel vectors to the body twist, for `exact` and `paper`.

    Args:
        x_m: (4,) wheel positions ahead in the body frame, m.
        y_m: (4,) the same to the left, m.
        model: `exact` or `paper`.

    Raises:
        UsageError: another model.
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
