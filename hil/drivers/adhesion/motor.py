"""A fan behind a motor controller on CAN: a force as what it is told, and its reports as samples."""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import NamedTuple, TypeVar

import can

from hil.config.adhesion import MotorConfig
from hil.drivers.adhesion.keeper.kept import Keep
from hil.drivers.adhesion.kept_motor import KeptMotor
from hil.drivers.adhesion.trim import Trim
from hil.drivers.stuck import StuckTest
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import HilError, UsageError
from hil.vocabulary.signals import AdhesionSample, Stamp, Status

_FASTEST = 3.0
"""Times the rated speed: no fan turns so fast."""
_STUCK_S = 0.5
_RUNNING_RPM = 1000.0

C = TypeVar("C", bound=MotorConfig)


class Figures(NamedTuple):
    """What a report says of the fan, NaN where it does not: as in `AdhesionSample`, in its order."""

    speed_rpm: float
    duty: float
    motor_a: float
    input_a: float
    input_v: float
    fet_c: float
    motor_c: float


class MotorFan(KeptMotor[C, AdhesionSample]):
    """One fan.

    Args:
        config: bus, id, ratings.
        clock: the bench clock.
        keep: makes who keeps the fan running, of (spec, clock).
        name: device name in errors.
    """

    def __init__(
        self,
        config: C,
        clock: Clock,
        keep: Keep,
        name: str = "adhesion",
    ) -> None:
        super().__init__(config, clock, keep, name, "the fan")

    def _forget(self) -> None:
        super()._forget()
        self._good_ns = self._clock.now_ns()
        self._stuck = StuckTest(_STUCK_S)
        self._trim: Trim | None = None
        self._latest: AdhesionSample | None = None

    def read(self) -> tuple[AdhesionSample, ...]:
        """One sample for each report of speed.

        Raises:
            DeviceTimeoutError: the controller has been silent for `fail_after_s`.
        """
        kept = self._must_be_open()
        frames, now_ns = self._link.take(), self._clock.now_ns()
        samples: list[AdhesionSample] = []
        if frames:
            trouble = kept.trouble()
            for t_ns, message in frames:
                if self._says_something(message):
                    samples += self._taken(t_ns, message, now_ns, trouble)
        if samples:
            self._good_ns = now_ns
            self._latest = samples[-1]
            self._link.error = ""
            if self._trim is not None:
                point = self._trim.better(samples[-1], kept.status)
                if point is not None:
                    kept.set(point)
        elif now_ns - self._good_ns > self._fail_ns:
            raise self._silence("the fan's controller", now_ns - self._good_ns, "it lets go of the motor")
        return tuple(samples)

    def _sample(self, figures: Figures, raw: object, t_ns: int, now_ns: int, trouble: str) -> AdhesionSample:
        """A report as a sample; `raw` is what never stays the same while a fan runs."""
        status = Status.OK
        too_fast = abs(figures.speed_rpm) > _FASTEST * self._config.rated_rpm
        if too_fast or abs(figures.duty) > 1.05:
            status = Status.IMPLAUSIBLE
        elif self._stuck.stuck(raw, t_ns) and abs(figures.speed_rpm) > _RUNNING_RPM:
            status = Status.FROZEN
        self._sequence += 1
        if status is not Status.OK:
            figures = figures._replace(speed_rpm=math.nan, duty=math.nan, motor_a=math.nan)
        stamp = Stamp(t_ns, now_ns, self._sequence)
        return AdhesionSample(stamp, *figures, status, trouble)

    def set_force_n(self, force_n: float) -> None:
        """Ask for a force; the speed that gives it is kept up whatever the battery does.

        Raises:
            UsageError: not a force that the fan may give; nothing is sent.
        """
        highest_n = self._config.highest_force_n
        if not (math.isfinite(force_n) and 0.0 < force_n <= highest_n):
            raise UsageError(
                f"{self.name}: a force of {force_n:g} N",
                expected=f"above 0, at most {highest_n:g} N (adhesion.highest_force_n)",
                remedy="`hil adhesion off` lets the fan come to rest",
            )
        kept = self._must_be_open()
        trim = Trim(self._config, self._config.speed_for_rpm(force_n), self._input_v(), self._latest)
        kept.set(trim.point)
        self._trim = trim

    def set_duty(self, duty: float) -> None:
        """Ask for a duty as it is; raises `UsageError`."""
        point = self._duty(duty)
        self._must_be_open().set(point)
        self._trim = None

    def brace(self) -> None:
        """Ask for the highest force that is allowed; never raises."""
        with contextlib.suppress(HilError):
            self.set_force_n(self._config.highest_force_n)

    def _says_something(self, message: can.Message) -> bool:
        """Whether a frame may be of the fan's controller: its keeper's commands pass by here, too."""
        return message.is_extended_id

    @abstractmethod
    def _taken(self, t_ns: int, message: can.Message, now_ns: int, trouble: str) -> Iterator[AdhesionSample]:
        """The samples that a frame completes."""

    @abstractmethod
    def _input_v(self) -> float:
        """Battery voltage as it was reported last; NaN where it was not."""
