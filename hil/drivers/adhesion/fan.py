"""The fan behind a VESC: its reports as samples, and a force as the duty, current or speed that gives it.

Commands are not sent from here. A keeper sends them, which goes on when this program ends; it is told of
another set-point only. Reports are read from the bus, whoever commands.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import can

from hil.config.adhesion import VescConfig
from hil.drivers.adhesion.keeper.core import SetPoint
from hil.drivers.adhesion.keeper.kept import Kept
from hil.drivers.adhesion.keeper.spec import Spec
from hil.drivers.adhesion.settings import Answers
from hil.drivers.adhesion.trim import Trim
from hil.drivers.adhesion.vesc import Pong, Status4, Status5, decode
from hil.drivers.adhesion.vesc import Status as Status1
from hil.drivers.adhesion.who import Seen, ask_who
from hil.drivers.can_link import CanLink
from hil.drivers.stuck import StuckTest
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.errors import DeviceError, DeviceTimeoutError, HilError, UsageError
from hil.vocabulary.finding import Finding
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.signals import AdhesionSample, Stamp, Status

_FASTEST = 3.0
"""Times the rated speed: no fan turns so fast."""
_SLOW_REPORTS_NS = nanoseconds(1.5)
_STUCK_S = 0.5
_RUNNING_RPM = 1000.0


@dataclass
class _Slow:
    """The reports that come at the slower rate; NaN before, and when they stay out."""

    input_a: float = math.nan
    fet_c: float = math.nan
    motor_c: float = math.nan
    input_v: float = math.nan
    seen_ns: dict[str, int] = field(default_factory=dict)


class VescFan(Holding[AdhesionSample]):
    """One fan.

    Args:
        config: bus, id, ratings.
        clock: the bench clock.
        keep: makes who keeps the fan running, of (spec, clock).
        name: device name in errors.
    """

    def __init__(
        self,
        config: VescConfig,
        clock: Clock,
        keep: Callable[[Spec, Clock], Kept],
        name: str = "adhesion",
    ) -> None:
        self.name, self._config, self._clock = name, config, clock
        self._link = CanLink(name, config, clock)
        self._keep = keep
        self._kept: Kept | None = None
        self._identity: dict[str, str] = {}
        self._fail_ns = nanoseconds(config.fail_after_s)
        self._answers, self._seen = Answers(), Seen()
        self._forget()

    def _forget(self) -> None:
        self._slow = _Slow()
        self._sequence = 0
        self._good_ns = self._clock.now_ns()
        self._latest_ns = -1
        self._stuck = StuckTest(_STUCK_S)
        self._trim: Trim | None = None
        self._latest: AdhesionSample | None = None

    def open(self) -> None:
        """Find the controller, read how it is set, and see to it that somebody keeps the fan.

        Nothing is commanded; a fan that runs goes on as it runs.

        Raises:
            ConfigError: a time-out that cannot be meant.
            DeviceError: it is not there, not alone, tells nothing, or would let go of the robot.
        """
        self.close()
        spec = Spec(**self._config.keeper())
        self._link.open()
        try:
            self._answers = Answers()
            self._seen = ask_who(self._link, self._config, self._clock, self._answers)
            self._seen.check(self.name, self._link, self._config, self._answers, spec)
            self._kept = self._keep(spec, self._clock)
            self._kept.open()
        except BaseException:
            self.close()
            raise
        self._forget()
        self._identity = {
            "model": "VESC",
            "port": f"{self._link.port}, controller {self._config.controller_id}",
            "firmware": self._answers.firmware or "not told",
        }

    def close(self) -> None:
        """Let go of the bus; the fan goes on. Idempotent; never raises."""
        self._identity = {}
        kept, self._kept = self._kept, None
        if kept is not None:
            kept.close()
        self._link.close()

    def identity(self) -> Mapping[str, str]:
        """Model, bus, controller and firmware; empty while closed."""
        return self._identity

    def read(self) -> tuple[AdhesionSample, ...]:
        """One sample for each report of speed.

        Raises:
            DeviceTimeoutError: the controller has been silent for `fail_after_s`.
        """
        kept = self._must_be_open()
        now_ns = self._clock.now_ns()
        trouble = kept.trouble()
        samples = tuple(s for t_ns, m in self._link.take() for s in self._taken(t_ns, m, now_ns, trouble))
        if samples:
            self._good_ns = now_ns
            self._latest = samples[-1]
            self._link.error = ""
            if self._trim is not None and (point := self._trim.better(samples[-1])) is not None:
                kept.set(point)
        elif now_ns - self._good_ns > self._fail_ns:
            raise self._silent(now_ns)
        return samples

    def _taken(self, t_ns: int, message: can.Message, now_ns: int, trouble: str) -> Iterator[AdhesionSample]:
        said = decode(message.arbitration_id, message.data) if message.is_extended_id else None
        if said is None or isinstance(said, Pong) or said.controller_id != self._config.controller_id:
            return
        slow = self._slow
        if isinstance(said, Status4):
            slow.input_a, slow.fet_c, slow.motor_c = said.input_a, said.fet_c, said.motor_c
            slow.seen_ns["4"] = t_ns
        elif isinstance(said, Status5):
            slow.input_v = said.input_v
            slow.seen_ns["5"] = t_ns
        elif isinstance(said, Status1):
            if t_ns <= self._latest_ns:
                return
            self._latest_ns = t_ns
            yield self._sample(said, t_ns, now_ns, trouble)

    def _sample(self, said: Status1, t_ns: int, now_ns: int, trouble: str) -> AdhesionSample:
        slow, speed_rpm = self._slow, said.erpm / self._config.pole_pairs
        current_4 = t_ns - slow.seen_ns.get("4", -_SLOW_REPORTS_NS) < _SLOW_REPORTS_NS
        current_5 = t_ns - slow.seen_ns.get("5", -_SLOW_REPORTS_NS) < _SLOW_REPORTS_NS
        status = Status.OK
        if abs(speed_rpm) > _FASTEST * self._config.rated_rpm or abs(said.duty) > 1.05:
            status = Status.IMPLAUSIBLE
        elif self._stuck.stuck(said, t_ns) and abs(speed_rpm) > _RUNNING_RPM:
            status = Status.FROZEN
        self._sequence += 1
        good = status is Status.OK
        return AdhesionSample(
            Stamp(t_ns, now_ns, self._sequence),
            speed_rpm=speed_rpm if good else math.nan,
            duty=said.duty if good else math.nan,
            motor_a=said.current_a if good else math.nan,
            input_a=slow.input_a if current_4 else math.nan,
            input_v=slow.input_v if current_5 else math.nan,
            fet_c=slow.fet_c if current_4 else math.nan,
            motor_c=slow.motor_c if current_4 else math.nan,
            status=status,
            trouble=trouble,
        )

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
        trim = Trim(self._config, self._config.speed_for_rpm(force_n), self._slow.input_v, self._latest)
        kept.set(trim.point)
        self._trim = trim

    def set_duty(self, duty: float) -> None:
        """Ask for a duty as it is; raises `UsageError`."""
        if not (math.isfinite(duty) and 0.0 < duty <= 1.0):
            raise UsageError(
                f"{self.name}: a duty of {duty:g}", expected="above 0, at most 1",
                remedy="`hil adhesion off` lets the fan come to rest",
            )  # fmt: skip
        kept = self._must_be_open()
        kept.set(SetPoint("duty", duty))
        self._trim = None

    def brace(self) -> None:
        """Ask for the highest force that is allowed; never raises."""
        with contextlib.suppress(HilError):
            self.set_force_n(self._config.highest_force_n)

    def diagnose(self) -> tuple[Finding, ...]:
        """What the doctor wants to know of how the controller is set and kept."""
        return self._seen.findings(self.name, self._config, self._answers, self._kept)

    def _must_be_open(self) -> Kept:
        if self._kept is None:
            raise DeviceError(
                self.name, "used while closed", port=self._link.port, remedy="call open() first"
            )
        return self._kept

    def _silent(self, now_ns: int) -> DeviceTimeoutError:
        silent_s = (now_ns - self._good_ns) / NS_PER_S
        return DeviceTimeoutError(
            self.name,
            f"no report of the fan's controller for {silent_s:.1f} s{self._link.told()}: once no command "
            f"reaches it for {self._config.timeout_s:g} s it lets go of the motor. Secure the robot",
            port=self._link.port,
            expected="status message 1",
            remedy="plug the CAN adapter in again; check wiring, supply and bit rate",
        )
