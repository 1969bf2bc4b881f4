"""Model of the ducted fan, its motor and its battery: motor set-point in, speed and currents out.

All numbers are assumptions except the behaviour of the controller: it clips set-points, reduces the current
when its power stage is hot or the battery low, and releases the motor when commands stop.
"""

import math
from dataclasses import dataclass
from typing import Literal

from hil.config.adhesion import MotorConfig
from hil.core.clock import NS_PER_S
from hil.fakes.motor_controllers.true_parameters import MotorTruthOptions

Mode = Literal["released", "duty", "current", "rpm", "brake"]

HIGHEST_DUTY = 0.95
_SAG_OF_CHARGE = 0.2
_THERMAL_S, _PACK_S = 60.0, 0.1
_S_PER_H = 3600.0


@dataclass(frozen=True)
class Demand:
    """Set-point of the motor: duty, current in A, or speed of the fan in 1/min."""

    mode: Mode = "released"
    value: float = 0.0


class Fan:
    """Speed, battery and temperature of a fan; `advance` integrates them.

    Args:
        config: ratings of motor and fan.
        options: battery, limits and lags.
        gain: ratio of the true force to the force by the ratings.

    Attributes:
        speed_rpm: speed of the fan.
        motor_a, input_a, input_v, fet_c, duty: values that the controller measures.
        used_ah, used_wh: charge and energy drawn from the battery since the start.
        strength: share of the motor's power that is left under a fault.
    """

    def __init__(self, config: MotorConfig, options: MotorTruthOptions, gain: float) -> None:
        self._config, self._options, self._gain = config, options, gain
        self._t_ns = 0
        self.used_ah = self.used_wh = 0.0
        self.demand = Demand()
        self.speed_rpm = self.motor_a = self.input_a = self.duty = 0.0
        self.strength = 1.0
        self.input_v, self.fet_c = options.pack_v, options.ambient_c
        loaded_v = options.pack_v - options.pack_ohm * config.rated_input_a
        self._a_per_rpm2 = self._rated_motor_a(loaded_v) / config.rated_rpm**2
        per_rpm, square = 1.0 / config.rpm_per_v, options.motor_ohm * self._a_per_rpm2
        self._at_volts_terms = per_rpm, per_rpm**2, 4.0 * square, 2.0 * square
        self._hot_c = max(options.hot_end_c - options.hot_start_c, 1e-6)
        self._low_v = max(options.cut_start_v - options.cut_end_v, 1e-6)

    def _rated_motor_a(self, loaded_v: float) -> float:
        """Motor current at the rated speed at which the battery supplies the rated current."""
        ohm, back_v = self._options.motor_ohm, self._config.rated_rpm / self._config.rpm_per_v
        power_w = self._config.rated_input_a * loaded_v
        return (math.sqrt(back_v**2 + 4.0 * ohm * power_w) - back_v) / (2.0 * ohm)

    def duty_for(self, speed_rpm: float) -> float:
        """Return the duty that holds a speed, with the battery voltage sagging under that load."""
        motor_a = self._a_per_rpm2 * speed_rpm**2
        motor_v = speed_rpm / self._config.rpm_per_v + motor_a * self._options.motor_ohm
        input_v = self._options.pack_v
        for _ in range(4):
            input_v = self._options.pack_v - self._options.pack_ohm * motor_a * motor_v / input_v
        return motor_v / input_v

    def begin(self, speed_rpm: float) -> None:
        """Set the state of a fan that has run at a constant speed for a long time."""
        self.demand = Demand("duty", self.duty_for(speed_rpm))
        self.speed_rpm = speed_rpm
        motor_a = self._a_per_rpm2 * speed_rpm**2
        self.input_v -= self._options.pack_ohm * motor_a * self.demand.value
        self.fet_c += self._options.heating_c_per_a2 * motor_a**2
        self._measure()

    @property
    def force_n(self) -> float:
        """Force of this fan on the robot, N."""
        return self._gain * self._config.force_at_n(max(self.speed_rpm, 0.0))

    @property
    def settled(self) -> bool:
        """Whether the speed has reached its steady state within 0.2 % of the rated speed."""
        return abs(self._aim_rpm() - self.speed_rpm) < 0.002 * self._config.rated_rpm

    def advance(self, t_ns: int) -> None:
        """Integrate up to `t_ns`; steps of up to 20 ms are accurate enough."""
        dt_s = (t_ns - self._t_ns) / NS_PER_S
        if dt_s <= 0.0:
            return
        self._t_ns = t_ns
        options, aim_rpm = self._options, self._aim_rpm()
        lag_s = options.spin_up_s if aim_rpm > self.speed_rpm else options.spin_down_s
        self.speed_rpm = aim_rpm + (self.speed_rpm - aim_rpm) * math.exp(-dt_s / lag_s)
        self._measure()
        warm_c = options.ambient_c + options.heating_c_per_a2 * self.motor_a**2
        self.fet_c += (warm_c - self.fet_c) * (1.0 - math.exp(-dt_s / _THERMAL_S))
        self.used_ah += self.input_a * dt_s / _S_PER_H
        self.used_wh += self.input_a * self.input_v * dt_s / _S_PER_H
        empty = min(self.used_ah / options.pack_ah, 1.0)
        loaded_v = options.pack_v * (1.0 - _SAG_OF_CHARGE * empty) - options.pack_ohm * self.input_a
        self.input_v += (loaded_v - self.input_v) * (1.0 - math.exp(-dt_s / _PACK_S))

    def highest_a(self) -> float:
        """Return the motor current limit at the present temperature and battery voltage."""
        o = self._options
        cool = (o.hot_end_c - self.fet_c) / self._hot_c
        full = (self.input_v - o.cut_end_v) / self._low_v
        if cool >= 1.0 and full >= 1.0:
            return o.highest_a
        return o.highest_a * min(max(min(cool, full), 0.0), 1.0)

    def _aim_rpm(self) -> float:
        """Steady-state speed at the present set-point, voltage and current limit."""
        mode, value = self.demand.mode, self.demand.value
        if mode in ("released", "brake"):
            return 0.0
        if mode == "duty":
            aim = self._at_volts(abs(value) * self.input_v)
        elif mode == "current":
            aim = min(math.sqrt(abs(value) / self._a_per_rpm2), self._at_volts(HIGHEST_DUTY * self.input_v))
        else:
            aim = min(abs(value), self._at_volts(HIGHEST_DUTY * self.input_v))
        aim = min(aim, math.sqrt(self.highest_a() / self._a_per_rpm2)) * math.sqrt(self.strength)
        return math.copysign(aim, value)

    def _at_volts(self, motor_v: float) -> float:
        """Steady-state speed at a motor voltage: back-EMF plus resistive drop."""
        per_rpm, squared, four, two = self._at_volts_terms
        return (math.sqrt(squared + four * motor_v) - per_rpm) / two

    def _measure(self) -> None:
        """Update currents and duty from the present speed."""
        mode, value, speed = self.demand.mode, self.demand.value, self.speed_rpm
        limit_a = self.highest_a()
        back_v = speed / self._config.rpm_per_v
        if mode == "released":
            self.motor_a = self.duty = 0.0
        elif mode == "duty":
            wanted_a = (value * self.input_v - back_v) / self._options.motor_ohm
            self.motor_a = min(max(wanted_a, -limit_a), limit_a)
            limited = (back_v + self.motor_a * self._options.motor_ohm) / max(self.input_v, 1.0)
            self.duty = value if self.motor_a == wanted_a else limited
        else:
            wanted_a = value if mode == "current" else self._a_per_rpm2 * speed * abs(speed)
            self.motor_a = 0.0 if mode == "brake" else min(max(wanted_a, -limit_a), limit_a)
            self.duty = (back_v + self.motor_a * self._options.motor_ohm) / max(self.input_v, 1.0)
        self.input_a = self.motor_a * self.duty
