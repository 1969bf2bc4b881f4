"""One cycle of the fan daemon on the CAN bus: receive, decide, send. A failed bus is retried for ever."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import can

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError
from hil.fan_daemon.fan_control import FanControl, SetPoint
from hil.fan_daemon.protocols import Wire, protocol_of
from hil.fan_daemon.spec import Spec
from hil.links import can_interface
from hil.links.can_interface import BusFailedError, OpenBus

_MOST_FRAMES, _MOST_ERRORS = 512, 16
_OPENING_S = 0.01
_REOPEN_NS = nanoseconds(0.5)
_REPEAT_NS = nanoseconds(10.0)
_ECHOES = 16


def open_bus(spec: Spec) -> can.BusABC:
    """The fan's bus; raises `DeviceError`."""
    shared = "a python-can interface that several programs can share, such as socketcan"
    return can_interface.open_bus(spec.device, spec, expected=shared)


class _Opening:
    """Opens a bus in a thread: an interface may wait for minutes, and the daemon must go on answering.

    Attributes:
        bus, error: the outcome; both None while the thread is at work.
    """

    def __init__(self, spec: Spec) -> None:
        self.bus: can.BusABC | None = None
        self.error: str | None = None
        self._spec, self._wanted = spec, True
        self._thread = threading.Thread(target=self._open, name="opening CAN", daemon=True)
        self._thread.start()

    def is_done(self) -> bool:
        """Whether the outcome is there; waits for it 10 ms."""
        self._thread.join(_OPENING_S)
        return not self._thread.is_alive()

    def abandon(self) -> None:
        """Shut the bus down as soon as it is open."""
        self._wanted = False
        if self.bus is not None:
            OpenBus(self.bus).shut()

    def _open(self) -> None:
        try:
            self.bus = open_bus(self._spec)
        except DeviceError as error:
            self.error = error.message
        else:
            if not self._wanted:
                OpenBus(self.bus).shut()


class BusCycle:
    """Sends the commands of a fan on its bus, a cycle at a time.

    Args:
        spec: the fan.
        control: control that decides what to send.
        say: function that logs a line of text for each change.
        bus: open bus; opened in the first cycle when None, and again whenever it is lost.

    Attributes:
        bus_error: error of the bus, in words; empty for nothing.
        sent_ns: time at which the latest command was sent.
        worst_gap_ns: the longest time between two commands since the fan is commanded.
        commands: commands sent.
    """

    def __init__(
        self, spec: Spec, control: FanControl, say: Callable[[str], None], bus: can.BusABC | None = None
    ) -> None:
        self._spec, self.control, self._say = spec, control, say
        self._bus = None if bus is None else OpenBus(bus)
        self._opening: _Opening | None = None
        self._protocol = protocol_of(spec)
        self._mine: deque[Wire] = deque(maxlen=_ECHOES)
        self._state = ""
        self._sags = False
        self._quiet_until_ns = 0
        self._failing_ns: int | None = None
        self.bus_error = ""
        self.sent_ns: int | None = None
        self.worst_gap_ns = 0
        self.commands = 0

    def step(self, t_ns: int) -> None:
        """Receive, decide, send. Bus errors do not raise."""
        bus = self._bus or self._opened(t_ns)
        failure = self._listen(bus, t_ns) if bus is not None else ""
        order = self.control.next_command(t_ns)
        if order is None:
            self.sent_ns, self.worst_gap_ns = None, 0
        elif bus is not None:
            failure = self._send(bus, order, t_ns) or failure
            if not failure:
                self._has_sent(t_ns)
        if failure:
            self._failed(failure, t_ns)
        elif bus is not None:
            self._failing_ns = None
            self._troubled("")
        if bool(self.control.trim.sag) != self._sags:
            self._sags = not self._sags
            self._say(self.control.trim.sag or "the fan turns as it was set again")
        if (state := self.control.state()) != self._state:
            self._state = state
            at = f" at {order.quantity} {order.value:.4g}" if order is not None and state != "idle" else ""
            self._say(f"{state}{at}")

    def status(self, t_ns: int) -> dict[str, Any]:
        """The state of control, fan and bus as plain values for JSON."""
        control = self.control
        return {
            "state": control.state(),
            "sent": control.sent,
            "target": control.aim,
            "sag": control.trim.sag,
            "sent_age_s": _age_s(self.sent_ns, t_ns),
            "worst_gap_s": self.worst_gap_ns / NS_PER_S,
            "commands": self.commands,
            "report": control.report,
            "report_age_s": _age_s(control.report_ns, t_ns),
            "others": sorted(control.others),
            "bus_error": self.bus_error,
            "timeout_s": self._spec.timeout_s,
        }

    def close(self) -> None:
        """Close the bus. Idempotent; never raises."""
        bus, self._bus = self._bus, None
        opening, self._opening = self._opening, None
        if bus is not None:
            bus.shut()
        if opening is not None:
            opening.abandon()

    def _opened(self, t_ns: int) -> OpenBus | None:
        if self._opening is None:
            if self._failing_ns is not None and t_ns - self._failing_ns < _REOPEN_NS:
                return None
            self._failing_ns, self._opening = t_ns, _Opening(self._spec)
        if not self._opening.is_done():
            return None
        opened, self._opening = self._opening, None
        if opened.bus is None:
            self._troubled(opened.error or "it cannot be opened")
            return None
        self._failing_ns, self._bus = None, OpenBus(opened.bus)
        return self._bus

    def _listen(self, bus: OpenBus, t_ns: int) -> str:
        """Process the frames that have arrived; a bounded number, as any node may send many.

        Returns:
            The failure of a bus that only fails; empty for one on which something is damaged.
        """
        failures = 0
        for _ in range(_MOST_FRAMES):
            try:
                message = bus.receive()
            except BusFailedError as error:
                failures += 1
                if failures == _MOST_ERRORS:
                    return str(error)
                continue
            if message is None:
                break
            if message.is_extended_id and not message.is_error_frame and not message.is_remote_frame:
                self._take((message.arbitration_id, bytes(message.data)), t_ns)
        return ""

    def _take(self, frame: Wire, t_ns: int) -> None:
        content = self._protocol.decode(*frame)
        if content is None:
            return
        if content.order is None:
            self.control.reported(t_ns, content.controller_id, content.report, content.running)
        elif frame not in self._mine:
            if self.control.sent is not None and t_ns >= self._quiet_until_ns:
                self._quiet_until_ns = t_ns + _REPEAT_NS
                self._say(
                    f"another program commands this fan: {content.order.quantity} {content.order.value:.4g}"
                )
            self.control.observe_command(t_ns, content.order)

    def _send(self, bus: OpenBus, order: SetPoint, t_ns: int) -> str:
        """Send the frames of a command; the failure of the bus, empty for none."""
        try:
            for frame_id, data in self._protocol.encode(order, t_ns):
                self._mine.append((frame_id, data))
                bus.send(frame_id, data, extended=True)
        except BusFailedError as error:
            return str(error)
        return ""

    def _has_sent(self, t_ns: int) -> None:
        if self.sent_ns is not None:
            self.worst_gap_ns = max(self.worst_gap_ns, t_ns - self.sent_ns)
        self.sent_ns = t_ns
        self.commands += 1

    def _failed(self, failure: str, t_ns: int) -> None:
        """The bus failed: try again in the next cycle, and reopen it when that does not help."""
        self._troubled(failure)
        if self._failing_ns is None:
            self._failing_ns = t_ns
        elif t_ns - self._failing_ns >= _REOPEN_NS:
            self.close()

    def _troubled(self, text: str) -> None:
        if text != self.bus_error:
            self.bus_error = text
            self._say(f"CAN: {text}; commands do not reach the fan" if text else "CAN: works again")


def _age_s(then_ns: int | None, now_ns: int) -> float | None:
    return None if then_ns is None else (now_ns - then_ns) / NS_PER_S
