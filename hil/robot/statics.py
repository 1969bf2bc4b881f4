"""Statics of a robot pressed on a surface: wheel loads, friction, and the fan force that it needs.

Forces in body axes; the surface's own axes have X up the wall. The tyres carry the tangential load as
creeping tyres do, each in proportion to its normal load. The share of its friction that a wheel uses then
does not depend on the stiffness of the tyres.
"""

import math
from dataclasses import dataclass, field

import numpy as np

GRAVITY_M_S2 = 9.81
_ROUNDS = 8
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class Statics:
    """A robot pressed on a surface: geometry, mass, tilt and friction.

    Attributes:
        wheel_x_m, wheel_y_m: (4,) contact points in the body.
        mass_kg, centre_of_mass_m: nominal values; x, y, height above the surface.
        propeller_height_m: height at which the propellers push.
        tilt_rad: tilt of the surface: 0 floor, pi/2 wall, more overhangs.
        friction: coefficient of friction between tyre and surface.
    """

    wheel_x_m: Four
    wheel_y_m: Four
    mass_kg: float
    centre_of_mass_m: tuple[float, float, float]
    propeller_height_m: float
    tilt_rad: float
    friction: float
    _spread: tuple[tuple[float, ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        spread = np.linalg.pinv(np.stack([np.ones(4), np.array(self.wheel_x_m), np.array(self.wheel_y_m)]))
        object.__setattr__(self, "_spread", tuple(tuple(row) for row in spread.tolist()))

    def _tangential_n(self, thrust_n: float, heading_rad: float) -> tuple[float, float, float, float]:
        """Tangential weight along body x and y, N, and the same with the propellers' thrust added."""
        along_n = self.mass_kg * GRAVITY_M_S2 * math.sin(self.tilt_rad)
        weight_x, weight_y = -along_n * math.cos(heading_rad), along_n * math.sin(heading_rad)
        return weight_x, weight_y, weight_x + thrust_n, weight_y

    def _moments(self, thrust_n: float, heading_rad: float) -> tuple[float, float]:
        """Moments of weight and propellers about the body's origin, N m: force times lever ahead, left."""
        x_m, y_m, height_m = self.centre_of_mass_m
        weight_x, weight_y, _, _ = self._tangential_n(thrust_n, heading_rad)
        about_y = self._press_n * x_m + height_m * weight_x + self.propeller_height_m * thrust_n
        return about_y, self._press_n * y_m + height_m * weight_y

    @property
    def _press_n(self) -> float:
        """Component of the weight towards the surface, N."""
        return self.mass_kg * GRAVITY_M_S2 * math.cos(self.tilt_rad)

    def loads_n(self, force_n: float, thrust_n: float, heading_rad: float) -> list[float]:
        """Normal load of each wheel, (4,), N; wheels cannot pull, so negative loads go to the others."""
        total_n = force_n + self._press_n
        about_y, about_x = self._moments(thrust_n, heading_rad)
        loads = [a * total_n + b * about_y + c * about_x for a, b, c in self._spread]
        if min(loads) >= 0.0:
            return loads
        carried = [max(n, 0.0) for n in loads]
        share = max(total_n, 0.0) / sum(carried) if any(carried) else 0.0
        return [share * n for n in carried]

    def utilisation(self, force_n: float, thrust_n: float, heading_rad: float) -> list[float]:
        """Share of its friction that each wheel uses, (4,); 1 slides, `inf` where nothing presses it.

        Args:
            force_n: force of the fan towards the surface.
            thrust_n: thrust of the propellers along body x.
            heading_rad: heading of the body on the surface.
        """
        loads = self.loads_n(force_n, thrust_n, heading_rad)
        weight_x, weight_y, push_x, push_y = self._tangential_n(thrust_n, heading_rad)
        x_m, y_m, _ = self.centre_of_mass_m
        moment = x_m * weight_y - y_m * weight_x
        s0 = sum(loads)
        sx = sum(n * x for n, x in zip(loads, self.wheel_x_m, strict=True))
        sy = sum(n * y for n, y in zip(loads, self.wheel_y_m, strict=True))
        places = tuple(zip(self.wheel_x_m, self.wheel_y_m, strict=True))
        square = sum(n * (x * x + y * y) for n, (x, y) in zip(loads, places, strict=True))
        left = square - (sx * sx + sy * sy) / s0 if s0 > 0.0 else 0.0
        if left <= 1e-9:
            return [math.inf] * 4
        turn = (moment + (sy * push_x - sx * push_y) / s0) / left
        ux, uy = (push_x + sy * turn) / s0, (push_y - sx * turn) / s0
        return [math.hypot(ux - turn * y, uy + turn * x) / self.friction for x, y in places]

    def friction_used(self, force_n: float, thrust_n: float, heading_rad: float) -> float:
        """Tangential over normal force of the robot: the friction coefficient at which it just slides."""
        _, _, push_x, push_y = self._tangential_n(thrust_n, heading_rad)
        return math.hypot(push_x, push_y) / (force_n + self._press_n)

    def needed_n(self, thrust_n: float, heading_rad: float) -> float:
        """Least fan force, N, at which the robot neither slides nor tips over a line between two wheels."""
        _, _, push_x, push_y = self._tangential_n(thrust_n, heading_rad)
        holds_n = math.hypot(push_x, push_y) / self.friction
        return max(holds_n - self._press_n, self._stands_n(thrust_n, heading_rad) - self._press_n, 0.0)

    def _stands_n(self, thrust_n: float, heading_rad: float) -> float:
        """Least total normal force, N, that acts between the wheels; `inf` where no force does."""
        about_y, about_x = self._moments(thrust_n, heading_rad)
        corners = list(zip(self.wheel_x_m, self.wheel_y_m, strict=True))
        least_n = 0.0
        for (x, y), (after_x, after_y) in zip(corners, corners[1:] + corners[:1], strict=True):
            edge_x, edge_y = after_x - x, after_y - y
            inside_m2, lever_n_m2 = x * edge_y - y * edge_x, edge_y * about_y - edge_x * about_x
            if inside_m2 > 0.0:
                least_n = max(least_n, lever_n_m2 / inside_m2)
            elif lever_n_m2 > 0.0:
                return math.inf
        return least_n

    def push_against_slide_n(self, force_n: float, thrust_n: float, heading_rad: float, *, up: bool) -> float:
        """Set-point of the propellers (N) that holds a robot which slides at the set-point `thrust_n`.

        A slide up shows that they truly push by more than weight and friction together: the new set-point
        then carries at least the weight, and holds a robot whose propellers are right after all. A slide
        down shows too little push or too little force: the new one carries the weight and half of the
        friction.

        Args:
            force_n: force of the fan towards the surface.
            thrust_n: present set-point of the propellers along body x.
            heading_rad: heading of the body on the surface.
            up: True if the robot slides along body x, False if against it.
        """
        weight_n = -self._tangential_n(0.0, heading_rad)[0]
        holds_n = self.friction * max(force_n + self._press_n, 0.0)
        if not up:
            return max(weight_n + 0.5 * holds_n, thrust_n)
        return thrust_n * max(weight_n, 0.0) / max(weight_n + holds_n, 1e-9)

    def force_for_n(self, utilisation: float, thrust_n: float, heading_rad: float) -> float:
        """Least force of the fan, N, that holds with every wheel at most at this utilisation; `inf`: none."""
        least_n = force_n = max(self.needed_n(thrust_n, heading_rad), 1.0)
        for _ in range(_ROUNDS):
            if not math.isfinite(force_n):
                return math.inf
            used = max(self.utilisation(force_n, thrust_n, heading_rad))
            force_n = max(force_n * used / utilisation, least_n)
        return force_n
