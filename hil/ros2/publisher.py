"""Publishes a bench on ROS 2: the messages of its recordings, byte by byte, while it runs.

In virtual time the loop's own thread sends them, and `/clock` last, by which nodes on simulated time act.
In real time the loop only hands a cycle over; a thread sends it while the loop sleeps.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any

from hil.config.ros2 import Ros2Config
from hil.core.clock import NS_PER_S, MonotonicClock
from hil.core.errors import ConfigError, HilError
from hil.core.external_commands import ExternalCommands
from hil.core.interfaces import HELD_NOTE, RUN_NOTE, CommandingSink, Sink
from hil.core.signals import CycleRecord
from hil.recording.needed_packages import recorded_kinds
from hil.recording.ros_messages import CycleMessages
from hil.recording.rosbags_adapter import MessageMaker
from hil.recording.topics import topics_with
from hil.recording.transform_tree import FrameTree, recorded_offset
from hil.recording.urdf import urdf
from hil.ros2 import diagnostics
from hil.ros2.command_exchange import Exchange
from hil.ros2.command_topic import CommandTopic, check_topic
from hil.ros2.network import Network
from hil.ros2.participant import Participant

LOG = logging.getLogger(__name__)
_CLOCK = "/clock"
_OWN = ("/hil/cycle", "/hil/notes", "/hil/events")
"""Topics of a recording that are not published: `/diagnostics` has the events."""
_WAITING = 100
_CLOSE_S = 2.0


class Ros2Publisher:
    """A participant on ROS 2 for the benches of one command, one after the other.

    Args:
        network: network on which it can be found.
        commanded_by: topic from which a program drives the benches; empty for none.
        patient: True to wait, in real time, for its first command without a timeout.

    Attributes:
        participant: DDS participant of its topics.
        dropped: cycles that were not published, because sending did not keep up or one was malformed.
        commands: the topic of the latest bench; None before the first, and where no program drives.
        exchange: exchange with the program of the latest bench; None likewise.

    Raises:
        UsageError: the network cannot be joined, or the topic name is invalid.
    """

    def __init__(self, network: Network, commanded_by: str = "", *, patient: bool = False) -> None:
        if commanded_by:
            check_topic(commanded_by)
        self.participant, self.dropped = Participant(network), 0
        self.commands: CommandTopic | None = None
        self.exchange: Exchange | None = None
        self._commanded_by, self._patient, self._latest_ns = commanded_by, patient, 0

    def sink(self, header: Mapping[str, Any]) -> Sink:
        """A sink for one bench; creates writers for those of its topics that have none yet.

        Args:
            header: header of the bench, as its recordings have it.
        """
        offset = recorded_offset(header)
        # simulated time begins at 1 s, since 0 means "no time yet", and the next bench's after this one's
        wall_ns = self._latest_ns + NS_PER_S if offset is None else offset.offset_ns
        messages = _Messages(self, header, wall_ns, self._passed if offset is None else None)
        if self._commanded_by:
            return self._commanded(messages, header, wall_ns, virtual=offset is None)
        return _WithinTheCycle(messages) if offset is None else _InRealTime(messages)

    def _commanded(
        self, messages: _Messages, header: Mapping[str, Any], wall_ns: int, *, virtual: bool
    ) -> CommandingSink:
        if self.commands is None:
            self.commands = CommandTopic(self.participant, self._commanded_by, reliable=virtual)
        config = messages.config
        self.exchange = Exchange(
            self.commands, messages, config, MonotonicClock(), wall_ns, patient=self._patient
        )
        wait_ns = round(config.wait_share * NS_PER_S / header["config"]["loop"]["rate_hz"])
        return _Commanding(messages, self.exchange, None if virtual else wait_ns)

    def _passed(self, t_ns: int) -> None:
        self._latest_ns = t_ns

    def close(self) -> None:
        """Leave the network, once what was written is sent. Idempotent; never raises."""
        if self.dropped:
            LOG.warning("ROS 2: %d cycles were not published", self.dropped)
        self.dropped = 0
        if self.commands is not None:
            self.commands.close()
        self.participant.close()


class _Messages:
    """Makes and sends the messages of one bench.

    Args:
        publisher: publisher that sends them.
        header: header of the bench, as its recordings have it.
        wall_ns: ROS time at the bench clock's zero.
        passed: called with the ROS time of every cycle; None in real time, where there is no `/clock`.

    Attributes:
        config: `[ros2]` of the bench file.
    """

    def __init__(
        self,
        publisher: Ros2Publisher,
        header: Mapping[str, Any],
        wall_ns: int,
        passed: Callable[[int], None] | None = None,
    ) -> None:
        self.publisher, self._passed, self._wall_ns = publisher, passed, wall_ns
        kinds = recorded_kinds(header)
        self._messages = CycleMessages(kinds, FrameTree(header), wall_ns)
        self._diagnostics = diagnostics.Diagnostics(str(header["config"]["name"]), MessageMaker(wall_ns))
        self._description = urdf(header)
        self._begun, self._shown_ns, self._clock_data = False, -1, b""
        hidden = (*_OWN, _CLOCK) if passed is None else _OWN
        self._topics = {name: kind for name, kind in topics_with(kinds).items() if name not in hidden}
        self._participant = publisher.participant
        offered = {**self._topics, diagnostics.TOPIC: diagnostics.TYPE}
        self.config = Ros2Config.model_validate(header["config"].get("ros2", {}))
        names = self.config.names
        if unknown := sorted(set(names) - set(offered)):
            raise ConfigError(
                f"ros2.names: {unknown[0]} is not published", expected="some of " + ", ".join(sorted(offered))
            )
        for name, kind in offered.items():
            self._participant.add_writer(name, kind, names.get(name, ""))

    def cycle(self, record: CycleRecord) -> None:
        """Send what a recording of this cycle holds; states first, then the time.

        Of a cycle that was already sent before its decision, only the events are sent.
        """
        shown = record.inputs.t_ns == self._shown_ns
        if not shown:
            self._states(record)
        if record.events:
            data = self._diagnostics.events(record.start_ns, record.events)
            self._participant.write(diagnostics.TOPIC, data)
        if not shown:
            self.show_time()

    def show(self, seen: CycleRecord) -> Collection[int]:
        """Send a cycle before it is decided, states first, then the time; returns the states' stamps."""
        self._shown_ns, stamps = seen.inputs.t_ns, set[int]()
        self.attempt(lambda: stamps.update(self._states(seen)))
        self.show_time()
        return stamps

    def show_time(self) -> None:
        """Send the latest time (again), where there is a `/clock`."""
        if self._passed is not None and self._clock_data:
            self._participant.write(_CLOCK, self._clock_data)

    def _states(self, record: CycleRecord) -> list[int]:
        stamps = []
        if not self._begun:
            self._begun = True
            for name, _, data in self._messages.first(record.start_ns, self._description):
                self._participant.write(name, data)
        for name, t_ns, data in self._messages.of(record):
            if name == _CLOCK:
                self._clock_data = data
            elif name in self._topics:
                self._participant.write(name, data)
                stamps.append(t_ns)
        if self._passed is not None:
            self._passed(record.start_ns + self._wall_ns)
        return stamps

    def held(self, t_ns: int, held: Mapping[str, object]) -> None:
        """Send how the robot was left."""
        self._participant.write(diagnostics.TOPIC, self._diagnostics.held(t_ns, held))

    def attempt(self, send: Callable[[], None]) -> None:
        """Call `send`; a failure to encode is counted, and logged once."""
        try:
            send()
        except HilError:  # raised by a signal handler
            raise
        except Exception as error:  # whatever a malformed record leads to must not reach the loop
            if not self.publisher.dropped:
                LOG.warning("ROS 2: a cycle could not be published (%r); more are only counted", error)
            self.publisher.dropped += 1


class _WithinTheCycle(Sink):
    """Sink that sends within the cycle."""

    def __init__(self, messages: _Messages) -> None:
        self._messages = messages

    def write(self, record: CycleRecord) -> None:
        """Send one cycle."""
        self._messages.attempt(lambda: self._messages.cycle(record))

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Send how the robot was left."""
        if kind == HELD_NOTE:
            self._messages.attempt(lambda: self._messages.held(t_ns, data))

    def close(self) -> None:
        """Do nothing: everything is already sent."""


class _Commanding(_WithinTheCycle, CommandingSink):
    """Sink that sends within the cycle, and receives the command of the program that drives.

    Args:
        messages: messages of the bench.
        exchange: exchange with the program.
        wait_ns: longest wait for a command from the beginning of its cycle; None for lockstep.
    """

    def __init__(self, messages: _Messages, exchange: Exchange, wait_ns: int | None) -> None:
        super().__init__(messages)
        self._exchange, self._wait_ns = exchange, wait_ns

    def ask(self, seen: CycleRecord) -> ExternalCommands:
        """Send the cycle; returns the program's commands for it."""
        if self._wait_ns is None:
            return self._exchange.in_lockstep(seen)
        return self._exchange.in_real_time(seen, seen.inputs.t_ns + self._wait_ns)

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Begin a run with the program, or send how the robot was left."""
        if kind == RUN_NOTE:
            self._exchange.begin()
        super().note(t_ns, kind, data)


class _InRealTime(Sink):
    """Sink with a queue and a thread that sends; if the queue is full, new cycles are dropped and counted."""

    def __init__(self, messages: _Messages) -> None:
        self._messages = messages
        self._waiting: deque[Callable[[], None]] = deque()
        self._something = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="ros2", daemon=True)
        self._thread.start()

    def write(self, record: CycleRecord) -> None:
        """Queue one cycle."""
        if len(self._waiting) < _WAITING:
            self._waiting.append(lambda: self._messages.cycle(record))
        else:
            self._messages.publisher.dropped += 1

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Queue how the robot was left."""
        if kind == HELD_NOTE:
            self._waiting.append(lambda: self._messages.held(t_ns, data))
            self._something.set()

    def rest(self) -> None:
        """Wake the thread that sends."""
        if self._waiting:
            self._something.set()

    def close(self) -> None:
        """Send the rest of the queue. Idempotent; never raises."""
        self._closed = True
        self._something.set()
        self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        """Thread: send the queue."""
        while True:
            self._something.wait()
            self._something.clear()
            closed = self._closed
            while self._waiting:
                self._messages.attempt(self._waiting.popleft())
            if closed:
                return
