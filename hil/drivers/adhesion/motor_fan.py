"""Base of the drivers of fans on CAN motor controllers: forces to commands, reports to samples.

The speed for a force is converted to the controller's set-point, which measurements that agree correct slowly
(`ForceKeeper`). A report that cannot be true is marked, and its bound named.
"""

import contextlib
import math
from abc import abstractmethod
from typing import Any, NamedTuple, TypeVar

import can

from hil.config.adhesion import MotorConfig
from hil.core.clock import Clock
from hil.core.errors import HilError, UsageError
from hil.core.signals import AdhesionSample, Stamp, Status
from hil.drivers.adhesion.force_keeper import ForceKeeper
from hil.drivers.motor_controllers.daemon_motor import DaemonMotor
from hil.fan_daemon.commander import MakeCommander
from hil.robot.motor_cross_checks import Reading, impossible
from hil.streams.silence_limit import SilenceTimer
from hil.streams.stuck_values import StuckTest

_VOLTS, _CELSIUS = (0.0, 150.0), (-60.0, 250.0)
"""Ranges of battery voltage and transistor temperature; a value outside is damaged and not used."""
_STUCK_S = 0.5
_RUNNING_RPM = 1000.0
_DUTY_STEP = 0.1
"""Largest change between two reports of a duty that is used beside an impossible speed."""
_IN_A_ROW = 3
"""Number of impossible reports after which they are more than single damaged frames."""
C = TypeVar("C", bound=MotorConfig)


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
        make_commander: function that makes the motor commander from (spec, clock); the daemon's client when
            None.
    """

    name = "adhesion"
    noun = "the fan"

    def __init__(self, config: C, clock: Clock, make_commander: MakeCommander | None = None) -> None:
        self._ratings = config.ratings()
        super().__init__(config, clock, make_commander)

    def _forget(self) -> None:
        super()._forget()
        self._silence_timer = SilenceTimer(self._config.fail_after_s)
        self._silence_timer.begin(self._clock.now_ns())
        self._stuck = StuckTest(_STUCK_S)
        self._keeper = ForceKeeper(self._config)
        self._beyond, self._duty_before = 0, math.nan

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
            self._link.error = ""
            point = self._keeper.correct(samples[-1].stamp.t_ns, commander.status().get("sent"))
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
        if not _VOLTS[0] <= figures.input_v <= _VOLTS[1]:
            figures = figures._replace(input_v=math.nan)
        speed_rpm, duty, motor_a, input_a, input_v, _, _ = figures
        now = Reading(speed_rpm, duty, input_v, motor_a, input_a)
        status, beyond = Status.OK, impossible(self._ratings, now)
        self._beyond = 0 if beyond is None else self._beyond + 1
        if beyond is not None or abs(duty) > 1.05:
            status = Status.IMPLAUSIBLE
        elif self._stuck.stuck(raw, t_ns) and speed_rpm > _RUNNING_RPM:
            status = Status.FROZEN
        if status is not Status.FROZEN:
            self._keeper.follow(t_ns, now)
        if beyond is not None and self._beyond >= _IN_A_ROW:
            trouble = "; ".join(filter(None, (trouble, beyond.text)))
        self._sequence += 1
        if status is not Status.OK:
            figures = figures._replace(speed_rpm=math.nan)
        as_before, self._duty_before = abs(duty - self._duty_before) <= _DUTY_STEP, duty
        if status is Status.FROZEN or abs(duty) > 1.05 or (beyond is not None and not as_before):
            figures = figures._replace(duty=math.nan, motor_a=math.nan)
        if not _CELSIUS[0] <= figures.fet_c <= _CELSIUS[1]:
            figures = figures._replace(fet_c=math.nan)
        stamp = Stamp(t_ns, now_ns, self._sequence)
        return AdhesionSample(stamp, *figures, status, trouble)

    def set_force_n(self, force_n: float) -> None:
        """Command a force; the speed that gives it is held while the battery voltage changes.

        Raises:
            UsageError: the force is out of range; nothing is sent.
        """
        self._set(force_n)

    def _set(self, force_n: float, *, press: bool = False) -> None:
        highest_n = self._config.highest_force_n
        if not (math.isfinite(force_n) and 0.0 < force_n <= highest_n):
            raise UsageError(
                f"{self.name}: a force of {force_n:g} N",
                expected=f"above 0, at most {highest_n:g} N (adhesion.highest_force_n)",
                remedy="`hil adhesion off` lets the fan come to rest",
            )
        commander = self._must_be_open()
        commander.set(self._keeper.start(self._config.speed_for_rpm(force_n), press=press))

    def set_duty(self, duty: float) -> None:
        """Command a fixed duty, without speed corrections; raises `UsageError`."""
        point = self._duty(duty)
        self._must_be_open().set(point)
        self._keeper.release()

    def brace(self) -> None:
        """Command the highest force that is allowed, by every measurement; never raises."""
        with contextlib.suppress(HilError):
            self._set(self._config.highest_force_n, press=True)

    @abstractmethod
    def _report(self, message: can.Message) -> Any:
        """Decode a report of the fan's controller; None for any other frame."""

    @abstractmethod
    def _figures(self, report: Any, t_ns: int) -> Figures | None:
        """Values of a speed report, completed from other reports; None for another report."""
