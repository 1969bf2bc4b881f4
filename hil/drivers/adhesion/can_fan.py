"""Base of the drivers of fans on CAN motor controllers: forces to commands, reports to samples.

The speed for a force is converted to the controller's set-point, which the measured speed corrects slowly.
"""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import can

from hil.config.adhesion import MotorConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import HilError, UsageError
from hil.core.signals import AdhesionSample, Stamp, Status
from hil.drivers.adhesion.can_motor import DaemonMotor
from hil.fan_daemon.commander import MakeCommander
from hil.fan_daemon.fan_control import SetPoint
from hil.links.silence_limit import SilenceTimer
from hil.links.stuck_values import StuckTest

_NOMINAL_V, _LEAST_V, _MOST_V = 22.2, 5.0, 100.0
"""Battery voltage (V) that is assumed where the reported one is not between the other two."""
_EVERY_NS = nanoseconds(0.2)
_SETTLING_NS, _AFTER_RAMP_NS = nanoseconds(1.5), nanoseconds(0.8)
"""Settling time of the fan after a new set-point, and after the end of the daemon's ramp towards it."""
_ARRIVED = 0.002
"""A ramp has ended when what is sent is within this share of the highest set-point."""
_TOLERANCE, _GAIN, _MOST = 0.003, 0.5, 0.03
_MOTOR_OVER_INPUT = 1.25
_NEAR = 0.15
_FASTEST = 3.0
"""Multiple of the rated speed above which a report is implausible."""
_VOLTS, _CELSIUS = (0.0, 150.0), (-60.0, 250.0)
"""Ranges of battery voltage and transistor temperature; a value outside is damaged and not used."""
_STUCK_S = 0.5
_RUNNING_RPM = 1000.0
C = TypeVar("C", bound=MotorConfig)


class SpeedTrim:
    """Holds a speed by corrections of the set-point.

    Args:
        config: ratings; `command` is the quantity of the set-point.
        speed_rpm: speed to hold.
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
        """The first set-point, from the ratings."""
        config, highest = self._config, self._config.daemon_spec()["highest"]
        if config.command == "rpm":
            return SetPoint("erpm", config.counts_per_turn * self._wanted_rpm)
        if config.command == "current":
            share = (self._wanted_rpm / config.rated_rpm) ** 2
            return SetPoint("current_a", share * _MOTOR_OVER_INPUT * config.rated_input_a)
        duty = self._wanted_rpm / (config.DROOP * config.rpm_per_v * input_v)
        return SetPoint("duty", min(duty, highest["duty"]))

    def better(self, sample: AdhesionSample, status: Callable[[], Mapping[str, Any]]) -> SetPoint | None:
        """A corrected set-point, when the fan has settled and still turns too fast or too slowly; else None.

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


class Figures(NamedTuple):
    """Values of a report, NaN for those it lacks; named and ordered as in `AdhesionSample`."""

    speed_rpm: float
    duty: float
    motor_a: float
    input_a: float
    input_v: float
    fet_c: float
    motor_c: float


class MotorFan(DaemonMotor[C, AdhesionSample]):
    """One fan.

    Args:
        config: bus, id, ratings.
        clock: the bench clock.
        make_commander: makes the motor commander from (spec, clock); the daemon's client when None.
    """

    name = "adhesion"
    noun = "the fan"

    def __init__(self, config: C, clock: Clock, make_commander: MakeCommander | None = None) -> None:
        self._fastest_rpm = _FASTEST * config.rated_rpm
        super().__init__(config, clock, make_commander)

    def _forget(self) -> None:
        super()._forget()
        self._silence_timer = SilenceTimer(self._config.fail_after_s)
        self._silence_timer.begin(self._clock.now_ns())
        self._stuck = StuckTest(_STUCK_S)
        self._trim: SpeedTrim | None = None
        self._latest: AdhesionSample | None = None

    def read(self) -> tuple[AdhesionSample, ...]:
        """One sample for each report of speed.

        Raises:
            DeviceTimeoutError: the controller has been silent for `fail_after_s`.
        """
        commander = self._must_be_open()
        samples: list[AdhesionSample] = self._link.read_samples()
        now_ns = self._clock.now_ns()
        if overdue_ns := self._silence_timer.overdue_ns(bool(samples), now_ns):
            raise self._silence("the fan's controller", overdue_ns, "it lets go of the motor")
        if samples:
            self._latest = samples[-1]
            self._link.error = ""
            if self._trim is not None:
                point = self._trim.better(samples[-1], commander.status)
                if point is not None:
                    commander.set(point)
        return tuple(samples)

    def _meaning(self, t_ns: int, message: can.Message, now_ns: int) -> AdhesionSample | None:
        report, commander = self._report(message), self._commander
        figures = None if report is None else self._figures(report, t_ns)
        if figures is None or t_ns <= self._latest_ns:
            return None
        self._latest_ns = t_ns
        return self._sample(figures, report, t_ns, now_ns, "" if commander is None else commander.trouble())

    def _sample(self, figures: Figures, raw: object, t_ns: int, now_ns: int, trouble: str) -> AdhesionSample:
        """A report as a sample; `raw` changes with every report while a fan runs, or the report is frozen."""
        status, speed_rpm = Status.OK, abs(figures.speed_rpm)
        if speed_rpm > self._fastest_rpm or abs(figures.duty) > 1.05:
            status = Status.IMPLAUSIBLE
        elif self._stuck.stuck(raw, t_ns) and speed_rpm > _RUNNING_RPM:
            status = Status.FROZEN
        self._sequence += 1
        if status is not Status.OK:
            figures = figures._replace(speed_rpm=math.nan, duty=math.nan, motor_a=math.nan)
        if not _VOLTS[0] <= figures.input_v <= _VOLTS[1]:
            figures = figures._replace(input_v=math.nan)
        if not _CELSIUS[0] <= figures.fet_c <= _CELSIUS[1]:
            figures = figures._replace(fet_c=math.nan)
        stamp = Stamp(t_ns, now_ns, self._sequence)
        return AdhesionSample(stamp, *figures, status, trouble)

    def set_force_n(self, force_n: float) -> None:
        """Command a force; the speed that gives it is held while the battery voltage changes.

        Raises:
            UsageError: the force is out of range; nothing is sent.
        """
        highest_n = self._config.highest_force_n
        if not (math.isfinite(force_n) and 0.0 < force_n <= highest_n):
            raise UsageError(
                f"{self.name}: a force of {force_n:g} N",
                expected=f"above 0, at most {highest_n:g} N (adhesion.highest_force_n)",
                remedy="`hil adhesion off` lets the fan come to rest",
            )
        commander = self._must_be_open()
        trim = SpeedTrim(self._config, self._config.speed_for_rpm(force_n), self._input_v(), self._latest)
        commander.set(trim.point)
        self._trim = trim

    def set_duty(self, duty: float) -> None:
        """Command a fixed duty, without speed corrections; raises `UsageError`."""
        point = self._duty(duty)
        self._must_be_open().set(point)
        self._trim = None

    def brace(self) -> None:
        """Command the highest force that is allowed; never raises."""
        with contextlib.suppress(HilError):
            self.set_force_n(self._config.highest_force_n)

    @abstractmethod
    def _report(self, message: can.Message) -> Any:
        """Decode a report of the fan's controller; None for any other frame."""

    @abstractmethod
    def _figures(self, report: Any, t_ns: int) -> Figures | None:
        """Values of a speed report, completed from other reports; None for another report."""

    @abstractmethod
    def _input_v(self) -> float:
        """Last reported battery voltage, V; NaN before the first report."""
