"""Converts a fan speed to the controller's command, and corrects it slowly by the measured speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hil.config.adhesion import MotorConfig
from hil.core.clock import nanoseconds
from hil.core.signals import AdhesionSample, Status
from hil.fan_daemon.fan_control import SetPoint

_NOMINAL_V, _LEAST_V, _MOST_V = 22.2, 5.0, 100.0
"""Battery voltage (V) where the controller reports none that can be."""
_EVERY_NS = nanoseconds(0.2)
_SETTLING_NS, _AFTER_RAMP_NS = nanoseconds(1.5), nanoseconds(0.8)
"""Time that the fan has from the set-point, and from the end of the daemon's ramp towards it."""
_ARRIVED = 0.002
"""Share of the highest set-point by which what is sent may differ from it at the end of a ramp."""
_TOLERANCE, _GAIN, _MOST = 0.003, 0.5, 0.03
_MOTOR_OVER_INPUT = 1.25
_NEAR = 0.15


class SpeedTrim:
    """Keeps a speed up.

    Args:
        config: ratings; `command` says in which quantity.
        speed_rpm: wanted.
        input_v: battery voltage, NaN where unknown.
        now: the fan's latest report.

    Attributes:
        point: the set-point for the controller now.
    """

    def __init__(
        self, config: MotorConfig, speed_rpm: float, input_v: float, now: AdhesionSample | None
    ) -> None:
        self._config, self._wanted_rpm = config, speed_rpm
        self._next_ns: int | None = None
        self._arrived = False
        self.point = self._first(input_v if _LEAST_V <= input_v <= _MOST_V else _NOMINAL_V)
        running = now is not None and abs(now.speed_rpm / speed_rpm - 1.0) < _NEAR
        if now is not None and running and self.point.quantity == "duty" and math.isfinite(now.duty):
            duty = now.duty * speed_rpm / now.speed_rpm
            self.point = SetPoint("duty", min(duty, config.daemon_spec()["highest"]["duty"]))

    def _first(self, input_v: float) -> SetPoint:
        """A first guess from the ratings."""
        config, highest = self._config, self._config.daemon_spec()["highest"]
        if config.command == "rpm":
            return SetPoint("erpm", config.counts_per_turn * self._wanted_rpm)
        if config.command == "current":
            share = (self._wanted_rpm / config.rated_rpm) ** 2
            return SetPoint("current_a", share * _MOTOR_OVER_INPUT * config.rated_input_a)
        duty = self._wanted_rpm / (config.DROOP * config.rpm_per_v * input_v)
        return SetPoint("duty", min(duty, highest["duty"]))

    def better(self, sample: AdhesionSample, status: Callable[[], Mapping[str, Any]]) -> SetPoint | None:
        """Another set-point, when the fan has had its time and still turns too fast or too slowly.

        Args:
            sample: its latest report.
            status: gives the status of its daemon; a fan whose set-point is still being ramped is not
                corrected.
        """
        t_ns = sample.stamp.t_ns
        if self._next_ns is None:
            self._next_ns = t_ns + _SETTLING_NS
        if not self._arrived:
            self._arrived = self._reached(status().get("sent"))
            self._next_ns = max(self._next_ns, t_ns + _AFTER_RAMP_NS)
        if t_ns < self._next_ns or sample.status is not Status.OK or self._config.command == "rpm":
            return None
        self._next_ns = t_ns + _EVERY_NS
        error = 1.0 - sample.speed_rpm / self._wanted_rpm
        if abs(error) < _TOLERANCE:
            return None
        highest = self._config.daemon_spec()["highest"][self.point.quantity]
        square = 2.0 if self.point.quantity == "current_a" else 1.0
        value = self.point.value * (1.0 + min(max(_GAIN * square * error, -_MOST), _MOST))
        self.point = SetPoint(self.point.quantity, min(value, highest))
        return self.point

    def _reached(self, sent: Sequence[Any] | None) -> bool:
        """Whether the daemon's ramp has come to the set-point."""
        if sent is None or sent[0] != self.point.quantity:
            return False
        highest = self._config.daemon_spec()["highest"][self.point.quantity]
        return bool(abs(sent[1] - self.point.value) <= _ARRIVED * highest)
