"""Finds the controllers on a VESC's bus, and checks the id and the settings of the configured one."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from hil.config.adhesion import VescConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.finding import Finding, Level
from hil.drivers.motor_controllers.vesc_settings import QUESTIONS, SHORT, Answers, question
from hil.fan_daemon.spec import Spec
from hil.links.can_bus import CanLink, remedy_of_silence
from hil.links.vesc import ALL_SERVOS, Pong, Status, Status4, Status5, decode, ping_frame

_WAIT_S = 0.01
_SETTINGS_S = 0.15
_MOST_LISTED = 8
_NEEDED = frozenset({1, 4, 5})
_OLDEST_FIRMWARE = (5, 3)
_MASKS = "switch on messages 1, 4 and 5 in VESC Tool (App Settings, General, CAN Status)"
_TIMEOUT = "set 1000 ms in VESC Tool (App Settings, General, Timeout)"
_IDS = "give each controller an id of its own in VESC Tool (App Settings, General, VESC ID)"


@dataclass
class BusReplies:
    """Replies and reports received during a search on the bus.

    Attributes:
        key: key of the bench file that holds the controller's id.
        pongs, statuses: numbers of answers to the one ping, and of status messages 1, by controller.
        messages: numbers of the status messages that the controller itself sent.
    """

    key: str = "controller_id"
    pongs: Counter[int] = field(default_factory=Counter)
    statuses: Counter[int] = field(default_factory=Counter)
    messages: set[int] = field(default_factory=set)

    def check(self, name: str, link: CanLink, config: VescConfig, answers: Answers, spec: Spec) -> None:
        """Raise `DeviceError` for a controller that is missing, silent, of a shared id or a bad timeout."""
        own, port = config.controller_id, link.port
        if not self.pongs[own] and not self.statuses[own]:
            raise self._absent(name, link, config)
        if self.pongs[own] > 1:
            raise DeviceError(
                name,
                f"{self.pongs[own]} controllers have the id {own}: each would obey",
                port=port,
                expected="one",
                remedy=_IDS,
            )
        if not self.statuses[own]:
            raise DeviceError(
                name,
                f"controller {own} answers, but sends no status message",
                port=port,
                expected="status messages 1, 4 and 5",
                remedy=_MASKS,
            )
        if answers.settings is not None:
            self._check_timeout(name, port, answers.settings.timeout_s, spec)

    @staticmethod
    def _check_timeout(name: str, port: str, timeout_s: float, spec: Spec) -> None:
        least_s = 10.0 * spec.period_s
        if timeout_s == 0.0:
            raise DeviceError(
                name,
                "the controller's timeout is 0: its motor would run for ever without commands",
                port=port,
                expected=f"at least {least_s:g} s",
                remedy=_TIMEOUT,
            )
        if timeout_s < least_s - 1e-9:
            raise DeviceError(
                name,
                f"the controller's timeout of {timeout_s:g} s is too short for commands every "
                f"{spec.period_s:g} s: one late command would let go of the robot",
                port=port,
                expected=f"at least {least_s:g} s",
                remedy=_TIMEOUT,
            )

    def _absent(self, name: str, link: CanLink, config: VescConfig) -> DeviceError:
        others = sorted({*self.pongs, *self.statuses})[:_MOST_LISTED]
        if others:
            message = ", ".join(map(str, others))
            return DeviceError(
                name,
                f"no controller has the id {config.controller_id}; there: {message}",
                port=link.port,
                expected=f"controller {config.controller_id}",
                remedy=f"set {name}.{self.key} to {others[0]} if that is the one",
            )
        return DeviceTimeoutError(
            name,
            f"no VESC answers{link.bus_errors()}",
            port=link.port,
            expected=f"controller {config.controller_id} at {config.bitrate} bit/s",
            remedy=remedy_of_silence(name, config, "the controller") + "; VESC Tool has its bit rate in App "
            "Settings, General, CAN Baud Rate",
        )

    def findings(self, name: str, config: VescConfig, answers: Answers) -> Iterator[Finding]:
        """Findings on the settings of the controller."""
        settings = answers.settings
        if settings is None:
            found = f"the controller does not report it; the bench file says {config.timeout_s:g} s"
            yield Finding(name, "timeout", "warning", found, "1 s", _TIMEOUT)
            sent = frozenset(self.messages)
        else:
            same = math.isclose(settings.timeout_s, config.timeout_s, abs_tol=1e-3)
            level: Level = "ok" if same else "warning"
            remedy = f"set {name}.timeout_s = {settings.timeout_s:g}"
            yield Finding(
                name, "timeout", level, f"{settings.timeout_s:g} s", f"{config.timeout_s:g} s", remedy
            )
            sent = settings.sent
        level = "ok" if sent >= _NEEDED else "warning"
        message = ", ".join(map(str, sorted(sent))) or "none"
        yield Finding(name, "status messages", level, message, "1, 4 and 5", _MASKS)
        yield self._firmware(name, answers.firmware)

    @staticmethod
    def _firmware(name: str, firmware: str) -> Finding:
        remedy = "update it with VESC Tool"
        if not firmware:
            return Finding(name, "firmware", "warning", "not reported", "5.03 or later", remedy)
        major, _, minor = firmware.partition(".")
        old = (int(major), int(minor)) < _OLDEST_FIRMWARE
        return Finding(name, "firmware", "warning" if old else "ok", firmware, "5.03 or later", remedy)


def discover_controllers(
    link: CanLink, config: VescConfig, clock: Clock, answers: Answers, *, listen_only: bool = False
) -> BusReplies:
    """Ping all controllers, request the configured one's settings, and listen until they come or time is up.

    Args:
        link: open bus.
        config: configuration of the wanted controller.
        clock: the bench clock.
        answers: collector of the settings of the controller.
        listen_only: True to send nothing.
    """
    seen = BusReplies()
    if not listen_only:
        ping = ping_frame(ALL_SERVOS, config.own_id)
        link.send(ping.id, ping.data, extended=True)
    asked, own = 0, config.controller_id
    end_ns = clock.now_ns() + nanoseconds(config.open_timeout_s)
    settled = over = False
    while not over:
        over = clock.now_ns() >= end_ns  # what came while this program stood still is looked at once more
        for _, message in link.take(_WAIT_S):
            if message.is_extended_id:
                _take(seen, answers, config, message.arbitration_id, bytes(message.data))
        if seen.pongs[own] and asked < len(QUESTIONS) and (not asked or answers.firmware):
            link.send(SHORT << 8 | own, question(QUESTIONS[asked], config.own_id), extended=True)
            asked += 1
        if seen.pongs[own] and seen.statuses[own] and not settled:
            settled, over, end_ns = True, False, clock.now_ns() + nanoseconds(_SETTINGS_S)
        over = over or (settled and answers.complete)
    return seen


def _take(seen: BusReplies, answers: Answers, config: VescConfig, frame_id: int, data: bytes) -> None:
    command, receiver = frame_id >> 8, frame_id & 0xFF
    reply = decode(frame_id, data)
    if isinstance(reply, Pong):
        if reply.asker_id == config.own_id:
            seen.pongs[reply.controller_id] += 1
    elif isinstance(reply, (Status, Status4, Status5)):
        seen.statuses[reply.controller_id] += isinstance(reply, Status)
        if reply.controller_id == config.controller_id:
            seen.messages.add({Status: 1, Status4: 4, Status5: 5}[type(reply)])
    elif receiver == config.own_id:
        answers.take(command, data)
