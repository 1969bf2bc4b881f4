"""Compares the work of the drives with the weight that they lift, as the bench file has it.

A robot that climbs by h does the work (m g - T) h against weight m g and push T of the propellers, beside
the losses in its gears and what speeds up its drives. The currents of the drives give the work, the wheels'
angles give h. So a wrong mass, or propellers that push less than the bench file says, show within
centimetres. Deterministic: depends only on the samples since `reset`.
"""

import math
from dataclasses import dataclass

from hil.core.clock import NS_PER_S
from hil.core.signals import Event, ServoSample, WheelMeasurement
from hil.core.stop_suspects import together
from hil.loop.cycle_data import Check, Cycle
from hil.robot.statics import GRAVITY_M_S2

_LEAST_M, _LEAST_SHARE = 0.03, 0.7
"""Height from which the work counts, and smallest share of the way that it is: else friction is all."""
_LOSS_N_M, _LOSS_N_M_S = 0.043, 0.023
"""Losses of a drive, of its gear at any speed, and by speed: the data sheet's rows without load have them."""
WRONG_SHARE = 0.17
"""Difference beyond which the bench file is contradicted, as a share of the weight: losses of gears that
differ by 40 % are a sixth of the weight of the robot of the shipped profiles."""
FITS_SHARE = 0.1
"""Difference up to which it is confirmed, as a share of the weight: what is between the two is open."""
_ROLLS_RAD_S, _STEADY_NS = 0.3, 300_000_000
_SPEEDING_SHARE = 0.1
"""Work that has gone into speed beyond which another stretch is judged, as a share of that against the
weight: the inertia of rotors and gears is assumed, the vendor gives none."""


@dataclass(frozen=True)
class Lifted:
    """What the bench file says of the weight.

    Attributes:
        mass_kg: mass.
        along: share of gravity along the surface.
        thrust_n: push of the propellers.
        torque_constant_n_m_a: torque of a drive by its current.
        radius_m: mean radius of the wheels.
        inertia_kg_m2: moment of inertia of a drive's rotor and gear, at the wheel.
        drive_sign: sign of each drive, (4,).
        keys: keys of the bench file that scale the push of the propellers.
    """

    mass_kg: float
    along: float
    thrust_n: float
    torque_constant_n_m_a: float
    radius_m: float
    inertia_kg_m2: float
    drive_sign: tuple[int, ...] = (1, 1, 1, 1)
    keys: tuple[str, ...] = ()

    @property
    def weight_n(self) -> float:
        """Weight along the surface."""
        return self.mass_kg * GRAVITY_M_S2 * self.along

    def moving_j(self, rates_rad_s: list[float]) -> float:
        """Kinetic energy of the body and its drives.

        Args:
            rates_rad_s: rates of the wheels, (4,).
        """
        one_kg_m2 = self.inertia_kg_m2 + 0.25 * self.mass_kg * self.radius_m**2
        return 0.5 * one_kg_m2 * sum(rate * rate for rate in rates_rad_s)


class WeightCheck(Check):
    """Checks the drives of one run on a wall.

    Args:
        lifted: weight, push and drives by the bench file.
        stops: True if a contradiction stops the robot.

    Attributes:
        lifted: weight, push and drives by the bench file.
        off_share: difference found, as a share of the weight; NaN before the robot has gone far enough.
    """

    def __init__(self, lifted: Lifted, *, stops: bool) -> None:
        self.lifted, self._stops = lifted, stops
        self.reset()

    def reset(self) -> None:
        """Clear the sums."""
        self._clear()
        self._last: tuple[int, list[float], float] | None = None
        self._rolls_since_ns: int | None = None
        self._told, self._judged, self.off_share = "", False, math.nan

    def _clear(self) -> None:
        """Begin a stretch."""
        self._work_j = self._speeding_j = self._height_m = self._way_m = 0.0

    def on_samples(self, cycle: Cycle) -> None:
        """Add the work of a cycle, and compare it with the weight."""
        if self._judged:
            if self._told and self._stops:
                cycle.stop("weight", self._told, ("thrust", "servos"))
            return
        for sample, wheels in zip(cycle.inputs.servos, cycle.measurements.wheels, strict=False):
            self._take(sample, wheels, cycle.last.heading_rad)
        if abs(self._height_m) > _LEAST_M:
            self._judge(cycle)

    def _take(self, sample: ServoSample, wheels: WheelMeasurement, heading_rad: float) -> None:
        """Add a step of four drives that roll steadily; a step that speeds up is other work, too."""
        t_ns, last = sample.stamp.t_ns, self._last
        angles: list[float] = wheels.wheel_angle_rad.tolist()
        rates: list[float] = wheels.wheel_rate_rad_s.tolist()
        moving_j = self.lifted.moving_j(rates)
        self._last = (t_ns, angles, moving_j)
        if last is None or not all(wheels.valid) or not 0 < t_ns - last[0] < NS_PER_S // 10:
            self._rolls_since_ns = None
            return
        if min(map(abs, rates)) < _ROLLS_RAD_S:
            self._rolls_since_ns = None
            return
        if self._rolls_since_ns is None:
            self._rolls_since_ns = t_ns
        if t_ns - self._rolls_since_ns < _STEADY_NS:
            return
        lifted, currents = self.lifted, sample.current_a.tolist()
        self._speeding_j += moving_j - last[2]
        for k, (angle, before, rate, steer) in enumerate(
            zip(angles, last[1], rates, wheels.steering_rad.tolist(), strict=True)
        ):
            turned = angle - before
            torque_n_m = lifted.torque_constant_n_m_a * currents[k] * lifted.drive_sign[k]
            loss_n_m = math.copysign(_LOSS_N_M + _LOSS_N_M_S * abs(rate), rate)
            self._work_j += (torque_n_m - loss_n_m) * turned
            way_m = 0.25 * turned * lifted.radius_m
            self._way_m += abs(way_m)
            self._height_m += way_m * math.cos(steer + heading_rad)

    def _judge(self, cycle: Cycle) -> None:
        """Compare once, when the robot has gone up or down for long enough."""
        if abs(self._height_m) < _LEAST_SHARE * self._way_m or not math.isfinite(self._work_j):
            return
        lifted = self.lifted
        if abs(self._speeding_j) > _SPEEDING_SHARE * lifted.weight_n * abs(self._height_m):
            self._clear()
            return
        self._judged = True
        found_n = (self._work_j - self._speeding_j) / self._height_m
        cycle.diagnostics["weight_less_push_n"] = found_n
        wanted_n = lifted.weight_n - lifted.thrust_n
        self.off_share = (found_n - wanted_n) / lifted.weight_n
        if abs(self.off_share) <= WRONG_SHARE:
            return
        mass_kg = (found_n + lifted.thrust_n) / (GRAVITY_M_S2 * lifted.along)
        keys = ", ".join(("robot.mass_kg", *lifted.keys))
        self._told = (
            f"the drives lift {found_n:.0f} N, and weight less push of the propellers are {wanted_n:.0f} N "
            f"by the bench file: look at {keys}; with the push as commanded the mass would be "
            f"{mass_kg:.2f} kg, with the mass as configured the push {lifted.weight_n - found_n:.0f} N in "
            f"place of {lifted.thrust_n:.0f}"
        )
        cycle.events.append(
            Event(cycle.inputs.t_ns, "warning", together(("thrust", "servos")), self._told, key=keys)
        )
