"""The fan behind a VESC: identity, settings, and reports as samples."""

import math
from dataclasses import dataclass, field
from typing import cast

import can

from hil.config.adhesion import VescConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.finding import Finding
from hil.drivers.adhesion.motor_fan import Figures, MotorFan
from hil.drivers.motor_controllers.vesc_identity import BusReplies, discover_controllers
from hil.drivers.motor_controllers.vesc_settings import Answers
from hil.fan_daemon.commander import MakeCommander, finding
from hil.fan_daemon.spec import Spec
from hil.links.vesc import Packet, Status, Status4, Status5, address, decode
from hil.streams.steady_volts import SteadyVolts

_SLOW_REPORTS_NS = nanoseconds(1.5)
Report = Status | Status4 | Status5
_READ = (Packet.STATUS, Packet.STATUS_4, Packet.STATUS_5)


@dataclass
class _Slow:
    """Values of the reports at the slower rate, with their times; NaN before the first."""

    input_a: float = math.nan
    fet_c: float = math.nan
    motor_c: float = math.nan
    input_v: float = math.nan
    seen_4_ns: int = -_SLOW_REPORTS_NS
    seen_5_ns: int = -_SLOW_REPORTS_NS
    _volts: SteadyVolts = field(default_factory=SteadyVolts)

    def take(self, report: Status4 | Status5, t_ns: int) -> None:
        """Store the values of a report."""
        if isinstance(report, Status5):
            self.input_v, self.seen_5_ns = self._volts.take(report.input_v), t_ns
        else:
            self.input_a, self.fet_c, self.motor_c = report.input_a, report.fet_c, report.motor_c
            self.seen_4_ns = t_ns


class VescFan(MotorFan[VescConfig]):
    """One fan; arguments as for `MotorFan`."""

    def __init__(self, config: VescConfig, clock: Clock, make_commander: MakeCommander | None = None) -> None:
        self._answers, self._seen = Answers(), BusReplies()
        self._reports = {address(packet, config.controller_id) for packet in _READ}
        super().__init__(config, clock, make_commander)

    def _forget(self) -> None:
        super()._forget()
        self._slow = _Slow()

    def _greet(self, spec: Spec) -> dict[str, str]:
        self._answers = Answers()
        self._seen = discover_controllers(self._link, self._config, self._clock, self._answers)
        self._seen.check(self.name, self._link, self._config, self._answers, spec)
        return {
            "model": "VESC",
            "port": f"{self._link.port}, controller {self._config.controller_id}",
            "firmware": self._answers.firmware or "not reported",
        }

    def _is_own(self, key: int) -> bool:
        return key in self._reports

    def _report(self, message: can.Message) -> Report | None:
        if message.arbitration_id not in self._reports or not message.is_extended_id:
            return None
        return cast("Report | None", decode(message.arbitration_id, message.data))

    def _figures(self, report: Report, t_ns: int) -> Figures | None:
        slow = self._slow
        if not isinstance(report, Status):
            slow.take(report, t_ns)
            return None
        old_ns = t_ns - _SLOW_REPORTS_NS
        current_4, current_5 = slow.seen_4_ns > old_ns, slow.seen_5_ns > old_ns
        return Figures(
            report.erpm / self._config.pole_pairs,
            report.duty,
            report.current_a,
            slow.input_a if current_4 else math.nan,
            slow.input_v if current_5 else math.nan,
            slow.fet_c if current_4 else math.nan,
            slow.motor_c if current_4 else math.nan,
        )

    def diagnose(self) -> tuple[Finding, ...]:
        """Findings on the settings and the daemon of the controller."""
        settings = self._seen.findings(self.name, self._config, self._answers)
        return (*settings, finding(self.name, self._commander))
