"""Effects of load on the servos: temperature, voltage drop, overload, and the resulting hardware errors."""

from collections.abc import Iterable

import numpy as np

from hil.config.servo_models import ServoModel
from hil.core.signals import SERVOS
from hil.fakes.servos.dynamixel.sensing import Sensing
from hil.fakes.servos.dynamixel.servo import Servo
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions

_HEATING_K_PER_W, _HEATING_S = 4.0, 300.0
_VOLTAGE, _OVERHEATED, _OVERLOAD = 0x01, 0x04, 0x20


class ThermalModel:
    """Supply and temperatures of eight servos.

    Args:
        sensing: source of the motor currents.
        options: supply, air temperature, overload limits.
        models: models of the eight servos.

    Attributes:
        volts: supply voltage at the servos.
        celsius: (8,) motor temperatures.
    """

    def __init__(self, sensing: Sensing, options: ServoBusOptions, models: tuple[ServoModel, ...]) -> None:
        self._sensing, self._options = sensing, options
        own = [m.motor.overload_a for m in models]
        self._overload_a = np.array(own if options.overload_a is None else [options.overload_a] * len(SERVOS))
        self._pack_v = self.volts = options.pack_v()
        self.celsius = np.full(len(SERVOS), options.ambient_c)
        self._overloaded_s = np.zeros(len(SERVOS))

    def step(self, servos: Iterable[Servo], dt_s: float) -> None:
        """Advance by `dt_s`, and set hardware errors of servos beyond their limits."""
        options = self._options
        current = np.abs(self._sensing.currents_a())
        self.volts = self._pack_v - options.supply_ohm * float(current.sum())
        target = options.ambient_c + _HEATING_K_PER_W * self._sensing.resistance_ohm * current**2
        self.celsius += (target - self.celsius) * (dt_s / _HEATING_S)
        heavy = current >= self._overload_a
        self._overloaded_s = np.where(heavy, self._overloaded_s + dt_s, 0.0)
        celsius, overloaded = self.celsius.tolist(), (self._overloaded_s >= options.overload_s).tolist()
        for servo in servos:
            if not servo.dead:
                self._judge(servo, celsius[servo.joint], overloaded[servo.joint])

    def _judge(self, servo: Servo, celsius: float, overloaded: bool) -> None:
        bits = _OVERLOAD if overloaded else 0
        if celsius > servo.temperature_limit:
            bits |= _OVERHEATED
        if not servo.least_voltage <= self.volts * 10 <= servo.most_voltage:
            bits |= _VOLTAGE
        if bits and bits & ~servo.table.get("hardware_error_status"):
            servo.raise_error(bits)
