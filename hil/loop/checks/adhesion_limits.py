"""The adhesion that a robot needs, and the forces by the samples of fan, load cells and propellers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hil.core.signals import AdhesionSample, LoadCellSample, Status, ThrustSample
from hil.robot.believed_force import UNCONFIRMED, Believed, believe
from hil.robot.motor_cross_checks import (
    MotorRatings,
    Reading,
    Steadiness,
    cross_check,
    forces_n,
    speed_by_voltage_rpm,
)
from hil.robot.statics import Statics

_EXCESS_SHARE, _LEAST_EXCESS = 0.15, 0.02
"""Tolerated excess of the propellers' push: as a share of the commanded push, at least of full push."""
_JUMP = 0.1
"""Share of the rated speed by which it differs from the report before in no report of a fan."""


class SlidePush(NamedTuple):
    """Set-point of the propellers against a slide.

    Attributes:
        force_n: set-point, N.
        raises: True against a slide down, for which it is not lowered.
    """

    force_n: float
    raises: bool


@dataclass(frozen=True)
class AdhesionLimits:
    """Limits of the adhesion check of one bench.

    Attributes:
        statics: nominal statics of robot and surface.
        reserve: smallest share by which the measured force exceeds the needed one; where no second sensor
            can confirm the force it is larger (`UNCONFIRMED`).
        utilisation: largest share of its friction that a wheel may use.
        nominal_thrust_n, full_thrust_n: push of the propellers where no throttle is reported, and full push.
        wanted_n: set-point of the fan at rest; its excess over the needed force is the whole margin.
        fan: ratings of the fan; None without one.
        low_input_v, hot_fet_c: limits of the fan's battery voltage and controller temperature.
        zero_n: sum of the load cells' zeros; None without cells.
        reports_thrust: True if the propellers' controllers report their speed.
        stale_s: silence after which fan, cells or reporting propellers are no longer trusted.
    """

    statics: Statics
    reserve: float = 0.25
    utilisation: float = 0.8
    nominal_thrust_n: float = 0.0
    full_thrust_n: float = 0.0
    wanted_n: float = math.nan
    fan: MotorRatings | None = None
    low_input_v: float = 0.0
    hot_fet_c: float = math.inf
    zero_n: float | None = None
    reports_thrust: bool = False
    stale_s: float = 0.25

    @property
    def has_fan(self) -> bool:
        """Whether a fan reports its speed."""
        return self.fan is not None

    @property
    def load_keys(self) -> tuple[str, ...]:
        """Keys of the bench file from which the load of each wheel is computed, beside the measured force."""
        pushed = ("thrust.full_force_n",) if self.full_thrust_n > 0.0 else ()
        return "robot.mass_kg", "robot.centre_of_mass_m", "environment.friction", *pushed

    @property
    def asked_share(self) -> float:
        """Multiple of the needed force below which no wheel may move."""
        both = self.has_fan and self.zero_n is not None
        return max(1.0 + self.reserve, 1.0 if both else UNCONFIRMED)

    def limit_n(self, thrust_n: float, heading_rad: float) -> float:
        """Force below which no wheel may move, N."""
        needed_n = self.asked_share * self.statics.needed_n(thrust_n, heading_rad)
        return max(needed_n, self.statics.force_for_n(self.utilisation, thrust_n, heading_rad))

    def cells_n(self, sample: LoadCellSample) -> float:
        """Force by the load cells minus their zeros, N; NaN if a cell cannot be used."""
        first_n, second_n = sample.force_n.tolist()
        return float(first_n + second_n) - (self.zero_n or 0.0)

    def speed_n(self, sample: AdhesionSample) -> float:
        """Force by the fan's speed, N."""
        return math.nan if self.fan is None else self.fan.force_at_n(sample.speed_rpm)

    def believed(self, forces: Mapping[str, float]) -> Believed:
        """The force that counts, of forces by name."""
        return believe(forces, math.inf if self.fan is None else self.fan.highest_n)

    def push_n(self, sample: ThrustSample) -> float:
        """Push by the propellers' speed, N; NaN if they do not report it."""
        if sample.status is not Status.OK:
            return math.nan
        return self.full_thrust_n * sample.throttle**2

    def push_against(self, along_m: float, force_n: float, heading_rad: float) -> SlidePush | None:
        """Set-point of the propellers against a slide (m along body x); None where it stays as it is.

        Args:
            along_m: slide, of which only the direction counts.
            force_n: adhesion force that is believed; NaN counts as none.
            heading_rad: heading of the body.
        """
        if not self.nominal_thrust_n or not along_m:
            return None
        pressed_n = force_n if math.isfinite(force_n) else 0.0
        push_n = self.statics.push_against_slide_n(
            pressed_n, self.nominal_thrust_n, heading_rad, up=along_m > 0.0
        )
        return SlidePush(min(push_n, self.full_thrust_n), raises=along_m < 0.0)

    def pushes_too_much(self, push_n: float) -> bool:
        """Whether the reported push exceeds the commanded one so far that it cannot be real.

        A propeller turns faster than commanded if it has no load, or its speed is miscounted.
        """
        wanted_n = self.nominal_thrust_n
        too_much_n = wanted_n + max(_EXCESS_SHARE * wanted_n, _LEAST_EXCESS * self.full_thrust_n)
        return self.reports_thrust and push_n > too_much_n


def reading(sample: AdhesionSample) -> Reading:
    """What the controller reports in a sample."""
    return Reading(sample.speed_rpm, sample.duty, sample.input_v, sample.motor_a, sample.input_a)


class _Jumps:
    """Tells single values that jump from changes that last."""

    def __init__(self) -> None:
        self._last: tuple[float, ...] | None = None
        self._doubted: tuple[float, ...] = ()

    def jumped(self, values: tuple[float, ...]) -> bool:
        """Whether a value differs from the one taken last, and the one before did not do so likewise."""
        if self._last is not None:
            seen = zip(values, self._last, self._doubted, strict=True)
            steps = [(now - a, before - a) for now, a, before in seen]
            self._doubted = values
            if any(abs(now) > _JUMP and abs(now - before) > 0.5 * abs(now) for now, before in steps):
                return True
        self._last = self._doubted = values
        return False


class FanForces:
    """Forces by the reports of a fan's controller, and what they say about each other.

    Args:
        fan: ratings of the fan; None without one.

    Attributes:
        forces_n: newest force by measurement, N.
        contradiction: contradiction between the newest measurements, as a text; empty for none.
        impossible: physical bound that the newest reports are beyond, as a text; empty for none.
    """

    def __init__(self, fan: MotorRatings | None) -> None:
        self._fan = fan
        self._steady = None if fan is None else Steadiness(fan)
        self._jumps = _Jumps()
        self.forces_n: dict[str, float] = {}
        self.contradiction = self.impossible = ""

    def take(self, sample: AdhesionSample) -> bool:
        """Take a sample; whether it gives a force: one beyond a bound does by duty and voltage alone.

        One that jumps as nothing real does is taken only if the one before did likewise: a message that was
        damaged on the wire is no reason to stop.
        """
        beyond = sample.status is Status.IMPLAUSIBLE and math.isfinite(sample.duty)
        if self._fan is None or self._steady is None or not (sample.status is Status.OK or beyond):
            return False
        now = reading(sample)
        speeds_rpm = (now.speed_rpm, speed_by_voltage_rpm(self._fan, now))
        if self._jumps.jumped(tuple(rpm / self._fan.rated_rpm for rpm in speeds_rpm)):
            return False
        steady = self._steady.follow(sample.stamp.t_ns, now)
        self.forces_n = forces_n(self._fan, now, steady=steady)
        self.impossible = sample.trouble if beyond else ""
        self.contradiction = cross_check(self._fan, now, steady=steady).text or self.impossible
        return bool(self.forces_n)
