"""Cross-checks of a motor that turns a fan or propellers: what its measurements say about each other.

A motor controller reports speed, duty, voltage and currents. Each becomes a force by numbers of the bench
file, and each would look different if one of these numbers were wrong. So the speed is compared with the
speed that duty and voltage give, with that of the power, and with what is possible at all. Pure functions of
measurements and ratings: driver, opening, loop, HELD, doctor and commands all ask here.

The law of the motor: voltage = speed / rpm_per_v + current x resistance, and the torque of a fan, so its
current, grows with the square of the speed, its power with the third power.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hil.core.cross_check import CrossCheck

DROOP = 0.93
"""Speed of a motor at its rated load over that of a free one at the same voltage; an assumption."""
SPEED_SHARE = 0.1
"""Tolerated difference of two speeds: 5 % of rpm_per_v, 3 % of droop, 2 % of sagging between two reports."""
_CHANGING_SHARE = 0.5
"""The same while the speed changes and the motor's current, which then differs, is not known."""
POWER_SHARE = 0.15
"""The same for the speed by power: 45 % of the power."""
_FREE_SHARE = 1.1
"""Multiple of the unloaded speed beyond which no speed is possible."""
FORCE_SHARE = 1.5
"""Multiple of the highest set-point beyond which no force is believed; full duty gives less."""
_TURNS_SHARE, _CHANGING_TURNS_SHARE = 0.2, 0.4
"""Share of the rated speed below which nothing is compared; the same while the speed changes."""
_BACKWARDS_SHARE = 0.02
_STEADY_SHARE, _LEAST_STEADY_SHARE, _STEADY_NS = 0.02, 0.002, 1_000_000_000
SPEED, VOLTAGE, POWER = "the fan's speed", "the fan's duty and voltage", "the fan's power"


def force_of_speed(rated_n: float, rated_rpm: float, speed_rpm: float) -> float:
    """Force of a fan or propeller at a speed, N; below 0 for one that turns backwards.

    Args:
        rated_n: force at the rated speed, N; the force goes with the square of the speed.
        rated_rpm: rated speed, 1/min.
        speed_rpm: speed, 1/min.
    """
    share = speed_rpm / rated_rpm
    return rated_n * share * abs(share)


@dataclass(frozen=True)
class MotorRatings:
    """Numbers of the bench file that turn a motor's measurements into speeds and forces.

    Attributes:
        table: table of the bench file, such as `adhesion`.
        rated_n, rated_rpm: force at a speed; it goes with the square of the speed.
        highest_n: largest set-point of the force, N.
        rated_w, rated_motor_a: power from the battery and current of the motor at that speed; NaN if unknown.
        rpm_per_v: unloaded speed per volt; NaN if unknown.
        pole_pairs: electrical turns per turn; 0 for a controller that reports turns.
        force_key, speed_key: keys of `rated_n` and `rated_rpm`.
    """

    table: str
    rated_n: float
    rated_rpm: float
    highest_n: float
    rated_w: float = math.nan
    rated_motor_a: float = math.nan
    rpm_per_v: float = math.nan
    pole_pairs: int = 0
    force_key: str = "rated_force_n"
    speed_key: str = "rated_rpm"

    def force_at_n(self, speed_rpm: float) -> float:
        """Force at a speed, N; below 0 for a motor that turns backwards."""
        return force_of_speed(self.rated_n, self.rated_rpm, speed_rpm)

    def motor_v(self, speed_rpm: float) -> float:
        """Voltage at the motor that holds a speed, V."""
        share = speed_rpm / self.rated_rpm
        return speed_rpm / self.rpm_per_v * (1.0 + (1.0 / DROOP - 1.0) * abs(share))

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the bench file that scale the force by the speed."""
        poles = (f"{self.table}.pole_pairs",) if self.pole_pairs else ()
        return (*poles, f"{self.table}.{self.force_key}", f"{self.table}.{self.speed_key}")


class Reading(NamedTuple):
    """Reports of a controller at one time; NaN where it gives none."""

    speed_rpm: float
    duty: float = math.nan
    input_v: float = math.nan
    motor_a: float = math.nan
    input_a: float = math.nan


def speed_by_voltage_rpm(ratings: MotorRatings, now: Reading) -> float:
    """Speed by duty and voltage, 1/min; NaN where one of them, or `rpm_per_v`, is unknown.

    With the motor's current the law also holds while the speed changes; without it, at a steady speed.
    """
    free_rpm = ratings.rpm_per_v * now.duty * now.input_v
    lost = (1.0 / DROOP - 1.0) * ratings.rated_rpm
    if math.isfinite(now.motor_a) and math.isfinite(ratings.rated_motor_a):
        return free_rpm - lost * now.motor_a / ratings.rated_motor_a
    if not free_rpm > 0.0:
        return free_rpm
    root = math.sqrt(1.0 + 4.0 * lost * free_rpm / ratings.rated_rpm**2)
    return 2.0 * free_rpm / (1.0 + root)


def speed_by_power_rpm(ratings: MotorRatings, now: Reading) -> float:
    """Speed by the power from the battery, 1/min, at a steady speed; NaN where it is not reported."""
    watts = now.input_a * now.input_v
    return ratings.rated_rpm * math.pow(max(watts / ratings.rated_w, 0.0), 1.0 / 3.0)


def impossible(ratings: MotorRatings, now: Reading) -> CrossCheck | None:
    """The physical bound that a report is beyond; None for a possible report."""
    speed_rpm, table = now.speed_rpm, ratings.table
    said = f"the reported {speed_rpm:.0f} 1/min are impossible"
    poles = f"{table}.pole_pairs" if ratings.pole_pairs else f"{table}.{ratings.speed_key}"
    known = float(ratings.pole_pairs or ratings.rated_rpm)
    if speed_rpm < -_BACKWARDS_SHARE * ratings.rated_rpm:
        text = f"{said}: what presses turns forwards; look at {poles} and at the motor's direction"
        return CrossCheck(poles, known, "contradicted", "its direction", -known, -2.0, text)
    fastest_rpm = _FREE_SHARE * ratings.rpm_per_v * now.input_v
    if speed_rpm > fastest_rpm:
        by = f"{ratings.rpm_per_v:g} 1/min per V ({table}.rpm_per_v) at {now.input_v:.1f} V"
        text = (
            f"{said}: {by} are at most {fastest_rpm / _FREE_SHARE:.0f}; look at {poles} and {table}.rpm_per_v"
        )
        return _contradiction(ratings, now, by, speed_by_voltage_rpm(ratings, now), text)
    force_n = ratings.force_at_n(speed_rpm)
    if force_n > FORCE_SHARE * ratings.highest_n:
        text = (
            f"{said}: they would give {force_n:.1f} N, and {ratings.highest_n:g} N are the most that is "
            f"asked for; look at {', '.join(dict.fromkeys((poles, *ratings.keys)))}"
        )
        return _contradiction(ratings, now, "the highest force", speed_by_voltage_rpm(ratings, now), text)
    return None


def _contradiction(ratings: MotorRatings, now: Reading, by: str, other_rpm: float, text: str) -> CrossCheck:
    """A speed that another measurement contradicts; a count of pole pairs that would explain it is named."""
    share = now.speed_rpm / other_rpm - 1.0 if other_rpm > 0.0 else math.nan
    if not ratings.pole_pairs:
        return CrossCheck(
            f"{ratings.table}.{ratings.speed_key}",
            ratings.rated_rpm,
            "contradicted",
            by,
            math.nan,
            share,
            text,
        )
    key, says = f"{ratings.table}.pole_pairs", ratings.pole_pairs * (1.0 + share)
    if math.isfinite(says) and round(says) not in (0, ratings.pole_pairs):
        text += f"; {ratings.pole_pairs} pole pairs are taken, {round(says)} would fit"
    return CrossCheck(key, ratings.pole_pairs, "contradicted", by, says, share, text)


def cross_check(ratings: MotorRatings, now: Reading, *, steady: bool = True) -> CrossCheck:
    """Compare a report of speed with everything else that the controller reports.

    Args:
        ratings: numbers of the bench file.
        now: the report.
        steady: True if the speed has been the same for a second: only then the power counts.
    """
    beyond = impossible(ratings, now)
    if beyond is not None:
        return beyond
    table = ratings.table
    key = f"{table}.pole_pairs" if ratings.pole_pairs else f"{table}.rpm_per_v"
    value = float(ratings.pole_pairs or ratings.rpm_per_v)
    unknown = CrossCheck(key, value, "unconfirmed")
    volts_rpm, power_rpm = speed_by_voltage_rpm(ratings, now), speed_by_power_rpm(ratings, now)
    with_current = math.isfinite(now.motor_a) and math.isfinite(ratings.rated_motor_a)
    tolerance, least = SPEED_SHARE, _TURNS_SHARE
    if not (steady or with_current):
        tolerance, least = _CHANGING_SHARE, _CHANGING_TURNS_SHARE
    if not steady:
        power_rpm = math.nan
    if not math.isfinite(now.speed_rpm):
        return unknown
    known = [rpm for rpm in (now.speed_rpm, volts_rpm, power_rpm) if math.isfinite(rpm)]
    if len(known) < 2 or max(known) < least * ratings.rated_rpm:
        return unknown
    said = f"by its speed {now.speed_rpm:.0f} 1/min, by duty and voltage {volts_rpm:.0f}"
    if not math.isfinite(volts_rpm):
        return _by_power(ratings, now, power_rpm, unknown)
    if far(now.speed_rpm, volts_rpm, tolerance):
        if math.isfinite(power_rpm):
            said += f", by its power {power_rpm:.0f}"
        if not far(power_rpm, now.speed_rpm, POWER_SHARE) and far(power_rpm, volts_rpm, POWER_SHARE):
            share = now.speed_rpm / volts_rpm - 1.0 if volts_rpm > 0.0 else math.nan
            text = f"{said}: look at {table}.rpm_per_v, and at the reported duty and voltage"
            says = ratings.rpm_per_v * (1.0 + share)
            return CrossCheck(
                f"{table}.rpm_per_v", ratings.rpm_per_v, "contradicted", SPEED, says, share, text
            )
        others = f"{table}.rpm_per_v and {table}.{ratings.speed_key}"
        text = f"{said}: look at {key}, then at the reported speed, and at {others}"
        return _contradiction(ratings, now, "duty and voltage", volts_rpm, text)
    if far(power_rpm, now.speed_rpm, POWER_SHARE):
        return _by_power(ratings, now, power_rpm, unknown)
    return CrossCheck(
        key,
        value,
        "confirmed",
        "duty and voltage",
        value * now.speed_rpm / volts_rpm,
        now.speed_rpm / volts_rpm - 1.0,
        within=tolerance,
    )


def _by_power(ratings: MotorRatings, now: Reading, power_rpm: float, unknown: CrossCheck) -> CrossCheck:
    """The comparison of the speed with the power alone."""
    if not math.isfinite(power_rpm):
        return unknown
    share = now.speed_rpm / power_rpm - 1.0 if power_rpm > 0.0 else math.nan
    if not far(power_rpm, now.speed_rpm, POWER_SHARE):
        return unknown._replace(
            state="confirmed", by="power", says=unknown.value, difference=share, within=POWER_SHARE
        )
    key = f"{ratings.table}.{ratings.speed_key}"
    says = ratings.rated_rpm * now.speed_rpm / power_rpm if power_rpm > 0.0 else math.nan
    text = (
        f"at {now.speed_rpm:.0f} 1/min its power is {now.input_a * now.input_v:.0f} W, which belongs to "
        f"{power_rpm:.0f} 1/min: {key} or {ratings.table}.rated_input_a, rated_input_v is wrong"
    )
    if ratings.pole_pairs and math.isfinite(ratings.rpm_per_v):  # the speed agrees with duty and voltage
        text += f", or {ratings.table}.pole_pairs and {ratings.table}.rpm_per_v both, by one factor"
    return CrossCheck(key, ratings.rated_rpm, "contradicted", "power", says, share, text)


def steady_band_rpm(ratings: MotorRatings, speed_rpm: float) -> float:
    """Largest change over a second, 1/min, of a speed at which the motor's power belongs to that speed.

    A motor that is slowed down takes less current than the fan needs. Its current is the difference of two
    voltages, and that grows with the square of the speed: so does the change that alters it by a given share.
    """
    share = (speed_rpm / ratings.rated_rpm) ** 2
    return ratings.rated_rpm * min(max(_STEADY_SHARE * share, _LEAST_STEADY_SHARE), _STEADY_SHARE)


def is_steady(ratings: MotorRatings, speeds_rpm: Sequence[float], speed_rpm: float) -> bool:
    """Whether speeds of a second or more, 1/min, about a typical one are those of a steady motor."""
    return max(speeds_rpm) - min(speeds_rpm) < steady_band_rpm(ratings, speed_rpm)


class Steadiness:
    """Detector of a motor speed that has been the same for a second.

    Args:
        ratings: numbers of the bench file.
    """

    def __init__(self, ratings: MotorRatings) -> None:
        self._ratings = ratings
        self._at_rpm, self._since_ns = math.nan, 0

    def follow(self, t_ns: int, now: Reading) -> bool:
        """Take a report; whether its speed, if known by duty and voltage, has been the same for a second."""
        volts_rpm = speed_by_voltage_rpm(self._ratings, now)
        speed_rpm = volts_rpm if math.isfinite(volts_rpm) else now.speed_rpm
        if not abs(speed_rpm - self._at_rpm) <= steady_band_rpm(self._ratings, speed_rpm):
            self._at_rpm, self._since_ns = speed_rpm, t_ns
        return t_ns - self._since_ns >= _STEADY_NS


def far(one: float, other: float, share: float) -> bool:
    """Whether two measurements differ by more than a share of the larger; False where one is NaN."""
    return abs(one - other) > share * max(abs(one), abs(other))


def forces_n(ratings: MotorRatings, now: Reading, *, steady: bool = True) -> dict[str, float]:
    """Force by each of the controller's measurements, N, by name; without those that it does not report."""
    found = {} if impossible(ratings, now) else {SPEED: ratings.force_at_n(now.speed_rpm)}
    if steady or math.isfinite(now.motor_a):
        found[VOLTAGE] = ratings.force_at_n(speed_by_voltage_rpm(ratings, now))
    if steady:
        found[POWER] = ratings.force_at_n(speed_by_power_rpm(ratings, now))
    return {name: force_n for name, force_n in found.items() if math.isfinite(force_n)}
