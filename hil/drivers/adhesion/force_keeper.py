"""Keeps the force of a fan: the set-point for a speed, and its corrections by measurements that agree.

No single report lowers the fan. The set-point follows the reported speed only while that speed agrees with
duty and voltage; where they disagree, duty times voltage is kept as it was when they last agreed. Where
nothing can be compared, the set-point is only raised.
"""

import math
from collections.abc import Sequence
from typing import Any

from hil.config.adhesion import MotorConfig
from hil.core.clock import nanoseconds
from hil.core.cross_check import CrossCheck
from hil.fan_daemon.fan_control import SetPoint
from hil.robot.motor_cross_checks import Reading, Steadiness, cross_check, far, speed_by_voltage_rpm

_NOMINAL_V, _LEAST_V, _MOST_V = 22.2, 5.0, 100.0
"""Battery voltage (V) that is assumed where the reported one is not between the other two."""
_EVERY_NS = nanoseconds(0.2)
_SETTLING_NS, _AFTER_RAMP_NS = nanoseconds(1.5), nanoseconds(0.8)
"""Settling time of the fan after a new set-point, and after the end of the daemon's ramp towards it."""
_ARRIVED = 0.002
"""A ramp has ended when what is sent is within this share of the highest set-point."""
_TOLERANCE, _GAIN, _MOST = 0.003, 0.5, 0.03
_NEAR = 0.15
_DRIFT_SHARE = 0.05
"""Tolerated change of speed over speed by duty and voltage, since both were first seen to agree."""
_DOUBTS = 3
"""Number of contradicted reports after which the speed is not followed."""
_RUNNING_DUTY = 0.05


class ForceKeeper:
    """Set-points of one fan.

    Args:
        config: ratings; `command` is the quantity of the set-point.

    Attributes:
        check: result of the latest comparison of the reported speed with the other measurements.
    """

    def __init__(self, config: MotorConfig) -> None:
        self._config, self._ratings = config, config.ratings()
        self._highest = config.daemon_spec()["highest"]
        self._steadiness = Steadiness(self._ratings)
        self._now: Reading | None = None
        self._ratio: float | None = None
        self._doubts = 0
        self._agrees = False
        self._wanted_rpm = math.nan
        self._point: SetPoint | None = None
        self._next_ns: int | None = None
        self._arrived = False
        self.check: CrossCheck | None = None

    def follow(self, t_ns: int, now: Reading) -> CrossCheck:
        """Take a report, and compare its speed with its other measurements."""
        steady = self._steadiness.follow(t_ns, now)
        self._now, self.check = now, cross_check(self._ratings, now, steady=steady)
        ratio = now.speed_rpm / volts_rpm if (volts_rpm := speed_by_voltage_rpm(self._ratings, now)) else 0.0
        self._agrees = self.check.state == "confirmed"
        if self._agrees and self.check.by != "power":
            if steady and self._ratio is None:
                self._ratio = ratio
            self._agrees = self._ratio is None or not far(ratio, self._ratio, _DRIFT_SHARE)
        doubted = self.check.state == "contradicted" or (self.check.state == "confirmed" and not self._agrees)
        self._doubts = self._doubts + 1 if doubted else 0
        return self.check

    def release(self) -> None:
        """Keep no speed from now on."""
        self._point = None

    def start(self, speed_rpm: float, *, press: bool = False) -> SetPoint:
        """The first set-point for a speed.

        Args:
            speed_rpm: speed to keep.
            press: True to press so much by every measurement, because the robot is losing its hold.
        """
        self._wanted_rpm, self._next_ns, self._arrived = speed_rpm, None, False
        now = self._now
        runs = now is not None and now.duty > _RUNNING_DUTY
        if now is None or not runs:
            self._point = self._by_ratings()
        elif press:
            nearer = speed_rpm / now.speed_rpm if now.speed_rpm > 0.0 else 0.0
            self._point = self._duty(max(self._by_voltage(), now.duty, now.duty * nearer))
        elif self._doubts:
            self._point = self._duty(max(self._by_voltage(), now.duty))
        elif self._config.command != "duty":
            self._point = self._by_ratings()
        elif self._agrees and not far(now.speed_rpm, speed_rpm, _NEAR):
            self._point = self._duty(now.duty * speed_rpm / now.speed_rpm)
        elif self._agrees:
            self._point = self._duty(self._by_voltage())
        else:
            self._point = self._duty(now.duty)
        return self._point

    def correct(self, t_ns: int, sent: Sequence[Any] | None) -> SetPoint | None:
        """A corrected set-point for the latest report; None to go on with the present one.

        Args:
            t_ns: time of the report.
            sent: set-point that the daemon sends now, quantity and value; one that is still being ramped is
                not corrected.
        """
        if self._point is None or self._now is None:
            return None
        if self._doubts >= _DOUBTS:
            return self._kept(self._now, sent)
        if not self._is_due(t_ns, sent) or self._doubts or self._config.command == "rpm":
            return None
        error = 1.0 - self._now.speed_rpm / self._wanted_rpm
        if not abs(error) >= _TOLERANCE or (error < 0.0 and not self._agrees):
            return None
        quantity, value = self._point
        if sent is not None and sent[0] == quantity:
            value = float(sent[1])
        square = 2.0 if quantity == "current_a" else 1.0
        value *= 1.0 + min(max(_GAIN * square * error, -_MOST), _MOST)
        self._point = SetPoint(quantity, min(value, self._highest[quantity]))
        return self._point

    def _kept(self, now: Reading, sent: Sequence[Any] | None) -> SetPoint | None:
        """Duty that keeps the voltage at the motor, never less than is sent; None where that is sent."""
        duty = now.duty
        if sent is not None and sent[0] == "duty":
            duty = float(sent[1])
        elif not math.isfinite(duty):
            return None
        volts_duty = self._by_voltage() if _LEAST_V <= now.input_v <= _MOST_V else 0.0
        aim = self._duty(max(duty, volts_duty))
        on_the_way = (
            self._point is not None and self._point.quantity == "duty" and self._point.value > aim.value
        )
        same = sent is not None and sent[0] == "duty" and aim.value <= (1.0 + _TOLERANCE) * duty
        if same or on_the_way:
            return None
        self._point = aim
        return aim

    def _is_due(self, t_ns: int, sent: Sequence[Any] | None) -> bool:
        """Whether the fan has settled since the last change."""
        if self._next_ns is None:
            self._next_ns = t_ns + _SETTLING_NS
        if not self._arrived:
            self._arrived = self._reached(sent)
            self._next_ns = max(self._next_ns, t_ns + _AFTER_RAMP_NS)
        if t_ns < self._next_ns:
            return False
        self._next_ns = t_ns + _EVERY_NS
        return True

    def _reached(self, sent: Sequence[Any] | None) -> bool:
        """Whether the daemon's ramp has come to the set-point."""
        if sent is None or self._point is None or sent[0] != self._point.quantity:
            return False
        return bool(abs(sent[1] - self._point.value) <= _ARRIVED * self._highest[self._point.quantity])

    def _by_ratings(self) -> SetPoint:
        """The set-point for the speed by the ratings, in the configured quantity."""
        config, quantity = self._config, self._config.command
        if quantity == "rpm":
            return SetPoint("erpm", config.counts_per_turn * self._wanted_rpm)
        if quantity == "current":
            share = (self._wanted_rpm / config.rated_rpm) ** 2
            return SetPoint("current_a", share * self._ratings.rated_motor_a)
        return self._duty(self._by_voltage())

    def _by_voltage(self) -> float:
        """Duty that gives the speed at the present voltage, corrected by the learned ratio."""
        volts = math.nan if self._now is None else self._now.input_v
        volts = volts if _LEAST_V <= volts <= _MOST_V else _NOMINAL_V
        return self._ratings.motor_v(self._wanted_rpm / (self._ratio or 1.0)) / volts

    def _duty(self, value: float) -> SetPoint:
        return SetPoint("duty", min(value, self._highest["duty"]))
