"""One MAVLink session with the odometry source: identity, messages, heartbeats, clock.

The sender's clock is mapped to the bench clock by TIMESYNC (111) round trips. A request carries the bench
time; the answer returns it with the sender's own. The sender is taken to read its clock half way between
request and answer. A difference between the two one-way delays makes an error of half that difference, which
no round trip can show. The shortest trip of the last 5 s counts, because queueing only ever adds delay.
"""

import logging
from collections import deque
from typing import Any, NamedTuple, TypeAlias

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.drivers.tracker.mavlink.packet_losses import PacketLosses
from hil.links.mavlink.messages import POSES, Parser, odometry_of
from hil.links.mavlink.transport_interface import Address, Arrival, Link

_QUICK_NS, _STEADY_NS = nanoseconds(0.02), nanoseconds(0.2)
_QUICK_TRIPS = 5
_WINDOW_NS = nanoseconds(5.0)
_FORGET_NS = nanoseconds(10.0)
_LONGEST_NS = nanoseconds(0.25)
_DRIFT, _SLACK_NS = 500e-6, 1_000_000
_OPEN_REQUESTS = 16
_LOG = logging.getLogger(__name__)
SYSTEM, COMPONENT = 255, 190
"""Ids of this host: the usual ones of ground stations, which every sender answers."""
_HEARTBEAT_NS = NS_PER_S
_MOST_SENDERS = 64
_ASK_AGAIN_NS, _ASKS = NS_PER_S // 2, 3
_LARGEST = 2048
_MOST_WASTED, _LEAST_WASTED = 16_384, 64
"""Bytes of datagrams not from the sender: the most that one exchange reads; the least that each counts."""
Source: TypeAlias = tuple[int, int]
"""System and component id."""


class Trip(NamedTuple):
    """One round trip: its end, its duration, and its clock offset (bench clock minus sender's clock)."""

    arrived_ns: int
    duration_ns: int
    offset_ns: int


class TimeSync:
    """Clock offset of one sender from round trips.

    Attributes:
        trips: answers taken since `reset`.
        steps: number of times that the sender's clock has jumped by more than two trips can explain.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all round trips."""
        self._asked: deque[int] = deque(maxlen=_OPEN_REQUESTS)
        self._window: deque[Trip] = deque()
        self._best: Trip | None = None
        self._next_ns = 0
        self.trips = self.steps = 0

    def due(self, now_ns: int) -> bool:
        """Whether a request is due; if so, it is recorded as sent at `now_ns`."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + (_QUICK_NS if self.trips < _QUICK_TRIPS else _STEADY_NS)
        self._asked.append(now_ns)
        return True

    def answered(self, asked_ns: int, device_ns: int, arrived_ns: int) -> bool:
        """Take an answer; False for one to no open request, or one that took too long to be of use."""
        if asked_ns not in self._asked:
            return False
        self._asked.remove(asked_ns)
        duration_ns = arrived_ns - asked_ns
        if not 0 <= duration_ns < _LONGEST_NS:
            return False
        trip = Trip(arrived_ns, duration_ns, (asked_ns + arrived_ns) // 2 - device_ns)
        if self._best is not None and self._contradicts(self._best, trip):
            self._window.clear()
            self.steps += 1
        self._window.append(trip)
        while arrived_ns - self._window[0].arrived_ns > _WINDOW_NS:
            self._window.popleft()
        self._best = min(reversed(self._window), key=lambda seen: seen.duration_ns)
        self.trips += 1
        return True

    def best(self, now_ns: int) -> Trip | None:
        """The shortest recent round trip; None when none has been answered for 10 s."""
        if self._window and now_ns - self._window[-1].arrived_ns > _FORGET_NS:
            self._window.clear()
            self._best = None
        return self._best

    @staticmethod
    def _contradicts(known: Trip, new: Trip) -> bool:
        """Whether two trips differ by more than clock drift and half their durations can explain."""
        drift_ns = _DRIFT * (new.arrived_ns - known.arrived_ns)
        possible_ns = (known.duration_ns + new.duration_ns) / 2 + drift_ns + _SLACK_NS
        return abs(new.offset_ns - known.offset_ns) > possible_ns


class Received(NamedTuple):
    """One odometry message and when it arrived on the bench clock."""

    message: Any
    arrived_ns: int


class Session:
    """Parses what arrives on a link, and sends what is due.

    Args:
        link: open link; closed with the session.
        common: the MAVLink dialect.
        config: the wanted sender.
        clock: the bench clock.

    Attributes:
        odometry: messages that have not been taken, the oldest first.
        last: the newest odometry message; None before the first.
        source: the sender; None until one has sent odometry.
        heard: types of messages received, by system and component, to name other senders.
        heartbeat, version: the sender's last HEARTBEAT and AUTOPILOT_VERSION.
        sync: clock offset of the sender.
        packets: arrivals of any content.
        malformed: pieces that are no MAVLink packet, or whose checksum is wrong; datagrams that are too long.
        strangers: messages from other senders.
        losses: lost packets of the sender, by the address that they come from.
        floods: exchanges that stopped reading after too many datagrams of no use; the rest waits.
        other_clock: poses in a row whose stamps are not of the clock that answers TIMESYNC.
    """

    def __init__(self, link: Link, common: Any, config: MavlinkTrackerConfig, clock: Clock) -> None:
        self._link, self._common, self._config, self._clock = link, common, config, clock
        self._parser = Parser(common, datagrams=link.datagrams)
        self._writer = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._peer: Address | None = link.peer
        self._heartbeat_ns = 0
        self.losses: dict[Address, PacketLosses] = {}
        self._ask_ns, self._asks_left = 0, _ASKS
        self.odometry: deque[Received] = deque(maxlen=config.queue_length)
        self.last: Any = None
        self.source: Source | None = None
        self.heard: dict[Source, set[str]] = {}
        self.heartbeat: Any = None
        self.version: Any = None
        self.sync = TimeSync()
        self.packets = self.malformed = self.strangers = self.floods = self.other_clock = 0
        self._overflowed = 0

    @property
    def overflowed(self) -> int:
        """Odometry that was not taken in time, and arrivals that the link could not keep."""
        return self._overflowed + self._link.overflowed

    @property
    def lost(self) -> int:
        """Packets that the sender has numbered and that never came."""
        return sum(losses.lost for losses in self.losses.values())

    @property
    def trouble(self) -> str:
        """Why nothing can arrive; empty while all is well."""
        return self._link.trouble

    @property
    def port_gone(self) -> bool:
        """Whether the link has failed for so long that it must be opened again."""
        return self._link.gone

    def exchange(self) -> None:
        """Read a bounded amount, as any program may send datagrams, and send what is due; never waits."""
        wasted = 0
        while wasted < _MOST_WASTED and (arrival := self._link.receive()) is not None:
            self.packets += 1
            if not self._is_of_use(arrival) and self._link.datagrams:
                wasted += max(_LEAST_WASTED, len(arrival.data))
        if wasted >= _MOST_WASTED:
            self.floods += 1
            if self.floods == 1:
                _LOG.warning(
                    "another program floods %s with datagrams of no use to the tracker", self._config.port
                )
        self._speak()

    def trip(self) -> Trip | None:
        """The round trip that gives the sender's clock offset now; None for none."""
        return self.sync.best(self._clock.now_ns())

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _is_of_use(self, arrival: Arrival) -> bool:
        """Take an arrival apart; whether anything in it came from the sender."""
        if self._link.datagrams and len(arrival.data) > _LARGEST:
            self.malformed += 1
            return False
        return any([self._take(message, arrival) for message in self._parser.feed(arrival.data)])

    def _take(self, message: Any, arrival: Arrival) -> bool:
        """Take a message; whether it came from the sender."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.malformed += 1
            return False
        source = message.get_srcSystem(), message.get_srcComponent()
        if source in self.heard or len(self.heard) < _MOST_SENDERS:
            self.heard.setdefault(source, set()).add(kind)
        if self.source is None:
            self._peer = arrival.sender
        if not self._is_wanted(source):
            self.strangers += 1
            if arrival.sender in self.losses:
                self.losses[arrival.sender].count_other(message.get_seq())
            return False
        if kind in POSES and self.source is None:
            self.source = source
        if source != self.source:
            return False
        self._peer = arrival.sender
        if arrival.sender in self.losses or len(self.losses) < _MOST_SENDERS:
            self.losses.setdefault(arrival.sender, PacketLosses()).count(message.get_seq())
        if kind == POSES[1] and POSES[0] not in self.heard.get(source, ()):
            kind, message = POSES[0], odometry_of(message, self._common)
        if kind == POSES[0]:
            self._overflowed += len(self.odometry) == self._config.queue_length
            self.odometry.append(Received(message, arrival.arrived_ns))
            self.last = message
        elif kind == "TIMESYNC":
            self._time(message, arrival.arrived_ns)
        elif kind == "HEARTBEAT":
            self.heartbeat = message
        elif kind == "AUTOPILOT_VERSION":
            self.version = message
        return True

    def _is_wanted(self, source: Source) -> bool:
        if self.source is not None:
            return source == self.source
        wanted = self._config.system_id, self._config.component_id
        return all(w in (None, s) for w, s in zip(wanted, source, strict=True))

    def _time(self, message: Any, arrived_ns: int) -> None:
        if message.tc1 == 0:
            self._send(self._common.MAVLink_timesync_message(self._clock.now_ns(), message.ts1))
        else:
            self.sync.answered(message.ts1, message.tc1, arrived_ns)

    def _speak(self) -> None:
        now_ns = self._clock.now_ns()
        if self._peer is None:
            return
        common = self._common
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + _HEARTBEAT_NS
            self._send(
                common.MAVLink_heartbeat_message(
                    common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
                )
            )
        if self.source is None:
            return
        if self.sync.due(now_ns):
            self._send(common.MAVLink_timesync_message(0, now_ns))
        if self.version is None and self._asks_left and now_ns >= self._ask_ns:
            self._ask_ns = now_ns + _ASK_AGAIN_NS
            self._asks_left -= 1
            self._ask_version(*self.source)

    def _ask_version(self, system: int, component: int) -> None:
        common = self._common
        self._send(
            common.MAVLink_command_long_message(
                system,
                component,
                common.MAV_CMD_REQUEST_MESSAGE,
                0,
                common.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
                0,
                0,
                0,
                0,
                0,
                0,
            )
        )

    def _send(self, message: Any) -> None:
        assert self._peer is not None
        writer = self._writer
        self._link.send(bytes(message.pack(writer)), self._peer)
        writer.seq = (writer.seq + 1) % 256
