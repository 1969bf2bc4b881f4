"""The fan behind a VESC: who it is, how it is set, and its reports as samples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import can

from hil.config.adhesion import VescConfig
from hil.drivers.adhesion.keeper.kept import Keep, finding
from hil.drivers.adhesion.keeper.spec import Spec
from hil.drivers.adhesion.motor import Figures, MotorFan
from hil.drivers.adhesion.settings import Answers
from hil.drivers.adhesion.vesc import Packet, Status, Status4, Status5, address, decode
from hil.drivers.adhesion.who import Seen, ask_who
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.finding import Finding
from hil.vocabulary.signals import AdhesionSample

_SLOW_REPORTS_NS = nanoseconds(1.5)
_READ = (Packet.STATUS, Packet.STATUS_4, Packet.STATUS_5)


@dataclass
class _Slow:
    """The reports that come at the slower rate; NaN before, and when they stay out."""

    input_a: float = math.nan
    fet_c: float = math.nan
    motor_c: float = math.nan
    input_v: float = math.nan
    seen_ns: dict[str, int] = field(default_factory=dict)


class VescFan(MotorFan[VescConfig]):
    """One fan; arguments as of any."""

    def __init__(
        self,
        config: VescConfig,
        clock: Clock,
        keep: Keep,
        name: str = "adhesion",
    ) -> None:
        self._answers, self._seen = Answers(), Seen()
        self._reports = {address(packet, config.controller_id) for packet in _READ}
        super().__init__(config, clock, keep, name)

    def _forget(self) -> None:
        super()._forget()
        self._slow = _Slow()

    def _greet(self, spec: Spec) -> dict[str, str]:
        self._answers = Answers()
        self._seen = ask_who(self._link, self._config, self._clock, self._answers)
        self._seen.check(self.name, self._link, self._config, self._answers, spec)
        return {
            "model": "VESC",
            "port": f"{self._link.port}, controller {self._config.controller_id}",
            "firmware": self._answers.firmware or "not told",
        }

    def _input_v(self) -> float:
        return self._slow.input_v

    def _says_something(self, message: can.Message) -> bool:
        return message.is_extended_id and message.arbitration_id in self._reports

    def _taken(self, t_ns: int, message: can.Message, now_ns: int, trouble: str) -> Iterator[AdhesionSample]:
        said, slow = decode(message.arbitration_id, message.data), self._slow
        if isinstance(said, Status4):
            slow.input_a, slow.fet_c, slow.motor_c = said.input_a, said.fet_c, said.motor_c
            slow.seen_ns["4"] = t_ns
        elif isinstance(said, Status5):
            slow.input_v = said.input_v
            slow.seen_ns["5"] = t_ns
        elif isinstance(said, Status):
            if t_ns <= self._latest_ns:
                return
            self._latest_ns = t_ns
            yield self._sample(self._figures(said, t_ns), said, t_ns, now_ns, trouble)

    def _figures(self, said: Status, t_ns: int) -> Figures:
        slow, never_ns = self._slow, -_SLOW_REPORTS_NS
        current_4 = t_ns - slow.seen_ns.get("4", never_ns) < _SLOW_REPORTS_NS
        current_5 = t_ns - slow.seen_ns.get("5", never_ns) < _SLOW_REPORTS_NS
        return Figures(
            speed_rpm=said.erpm / self._config.pole_pairs,
            duty=said.duty,
            motor_a=said.current_a,
            input_a=slow.input_a if current_4 else math.nan,
            input_v=slow.input_v if current_5 else math.nan,
            fet_c=slow.fet_c if current_4 else math.nan,
            motor_c=slow.motor_c if current_4 else math.nan,
        )

    def diagnose(self) -> tuple[Finding, ...]:
        """What the doctor wants to know of how the controller is set and kept."""
        set_so = self._seen.findings(self.name, self._config, self._answers)
        return (*set_so, finding(self.name, self._kept))
