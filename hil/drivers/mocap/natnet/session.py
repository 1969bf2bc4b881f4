"""Talks to a NatNet server: connection, versions, model definitions, keep-alive, frames.

Model definitions list the rigid bodies that a server streams, by streaming id. Since 4.1 every definition
contains its size; before, all kinds have to be read to get past them.
"""

import logging
import struct
from typing import TypeAlias

from hil.config.mocap import MocapConfig
from hil.core.clock import Clock, nanoseconds
from hil.drivers.mocap.natnet.messages import Frame, FrameParser, frame_number
from hil.drivers.mocap.natnet.packets import (
    MalformedPacket,
    Message,
    ServerInfo,
    parse_server_info,
    request,
    split,
)
from hil.drivers.mocap.natnet.payload_reader import Cursor
from hil.links.injection import FaultyDatagrams, with_faults
from hil.links.udp_ports import Address, Datagram, DatagramFactory, DatagramPort

_RIGID_BODY = 1
_PLACE = struct.Struct("<ii3f")
_QUATERNION, _OFFSET, _LABEL = 16, 12, 4
_PLATE_GEOMETRY = 4 * (2 + 3 + 144 + 12)
_CAMERA = 28
_LOG = logging.getLogger(__name__)
_MOST_DATAGRAMS = 4096
_MOST_WASTED = 256
_OTHER_SOURCE_AFTER_NS = 1_000_000_000
_OLD_FRAMES = 1000
_FRAME = Message.FRAME.value
_RESTART_NS = 250_000_000
NewFrame: TypeAlias = tuple[Frame, int, bool]
"""A frame, its arrival on the bench clock (ns), and whether the server has restarted before it."""


def parse_models(payload: bytes, version: tuple[int, int]) -> dict[int, str]:
    """Names of the rigid bodies by streaming id; raises `MalformedPacket` and nothing else."""
    cursor = Cursor(payload)
    bodies: dict[int, str] = {}
    sized = version >= (4, 1)
    for _ in range(cursor.count(8)):
        kind = cursor.integer()
        end = cursor.integer() + cursor.at if sized else None
        if kind == _RIGID_BODY:
            identifier, name = _rigid_body(cursor, version)
            bodies[identifier] = name
        elif end is None:
            _pass_over(cursor, kind, version)
        if end is not None:
            cursor.skip(end - cursor.at)
    return bodies


def _rigid_body(cursor: Cursor, version: tuple[int, int]) -> tuple[int, str]:
    name = cursor.text()
    identifier, *_ = cursor.take(_PLACE)
    if version >= (4, 2):
        cursor.skip(_QUATERNION)
    markers = cursor.count(_OFFSET + _LABEL)
    cursor.skip(markers * (_OFFSET + _LABEL))
    if version >= (4, 0):
        for _ in range(markers):
            cursor.text()
    return identifier, name


def _pass_over(cursor: Cursor, kind: int, version: tuple[int, int]) -> None:
    if kind == 0:
        cursor.text()
        _names(cursor)
    elif kind == 2:
        cursor.text()
        cursor.integer()
        for _ in range(cursor.count(_PLACE.size)):
            _rigid_body(cursor, version)
    elif kind == 3:
        cursor.integer()
        cursor.text()
        cursor.skip(_PLATE_GEOMETRY + 8)
        _names(cursor)
    elif kind == 4:
        cursor.integer()
        cursor.text()
        cursor.text()
        cursor.skip(8)
        _names(cursor)
    elif kind == 5:
        cursor.text()
        cursor.skip(_CAMERA)
    else:
        raise MalformedPacket(f"model definition of unknown kind {kind}")


def _names(cursor: Cursor) -> None:
    for _ in range(cursor.count(1)):
        cursor.text()


class Session:
    """Open ports to one server, and what it has sent so far.

    Args:
        config: addresses.
        clock: the bench clock.
        datagrams: function that opens ports; raises `OSError`.

    Attributes:
        server: its description, None until it has answered.
        version: (major, minor) of the bit stream.
        bodies: rigid bodies by streaming id, None until it has sent them.
        body_id: the one to look for in frames, None until it is known.
        malformed: packets that could not be parsed.
        strangers: packets from other hosts, or frames from another source than the usual one.
        taken: frames that were new.
        repeated: frames that came again or too late; a server that knows both ports sends each one twice.
        floods: calls of `frames` that stopped after too many datagrams of no use; the rest waits.
    """

    def __init__(self, config: MocapConfig, clock: Clock, datagrams: DatagramFactory) -> None:
        self._config, self._clock = config, clock
        self._address = (config.server, config.command_port)
        self.server: ServerInfo | None = None
        self.bodies: dict[int, str] | None = None
        self.body_id: int | None = config.body if isinstance(config.body, int) else None
        self.malformed = self.strangers = self.taken = self.repeated = self.floods = 0
        self.version = (0, 0)
        self._asked: tuple[int, int] | None = None
        self._agreed = False
        self._number: int | None = None
        self._parser: FrameParser | None = None
        self._seen: dict[int, tuple[float, int, int]] = {}
        self._source: Address | None = None
        self._source_ns = 0
        self._alive_ns, self._keepalive_ns = clock.now_ns(), nanoseconds(config.keepalive_s)
        self._ports: list[DatagramPort] = []
        try:
            self._ports.append(with_faults(datagrams(None, 0), FaultyDatagrams))
            self._open_data_port(datagrams)
        except BaseException:
            self.close()
            raise

    def _open_data_port(self, datagrams: DatagramFactory) -> None:
        """Multicast comes to the data port; unicast comes there too from some servers, if it is free."""
        group = self._config.multicast
        try:
            self._ports.append(with_faults(datagrams(group, self._config.data_port), FaultyDatagrams))
        except OSError:
            if group is not None:
                raise
            _LOG.debug(
                "data port %d is taken: frames are expected at the command port", self._config.data_port
            )

    def close(self) -> None:
        """Close the ports."""
        for port in self._ports:
            port.close()
        self._ports = []

    def connect(self) -> None:
        """Request the server's description; a unicast server then streams to this host."""
        self._send(request(Message.CONNECT, "Ping"))
        if self._agreed and self._asked is not None:
            self.ask_version(self._asked)

    def ask_models(self) -> None:
        """Request the model definitions."""
        self._send(request(Message.REQUEST_MODELS))

    def ask_version(self, version: tuple[int, int]) -> None:
        """Request another bit stream; `version` changes when the server has agreed."""
        self._asked = version
        self._send(request(Message.REQUEST, "Bitstream,{}.{}".format(*version)))

    def keep_alive(self, now_ns: int) -> None:
        """Send keep-alives to a unicast server from time to time."""
        if now_ns - self._alive_ns >= self._keepalive_ns and self._config.multicast is None:
            self._alive_ns = now_ns
            self._send(request(Message.KEEPALIVE))

    def frames(self) -> list[NewFrame]:
        """New frames that have arrived, with their arrival and whether the server has restarted."""
        found: list[NewFrame] = []
        wasted, repeated = 0, self.repeated
        for port in self._ports:
            for _ in range(_MOST_DATAGRAMS):
                datagram = port.receive() if wasted < _MOST_WASTED else None
                if datagram is None:
                    break
                try:
                    frame = self._take(datagram)
                except MalformedPacket:
                    self.malformed += 1
                    frame = None
                wasted += frame is None
                if frame is not None:
                    self.taken += 1
                    found.append((frame[0], datagram.arrived_ns, frame[1]))
        copies = self.repeated - repeated if self.repeated <= self.taken else 0
        if wasted >= _MOST_WASTED and wasted > 2 * copies:
            self._flooded()
        return found

    def _flooded(self) -> None:
        self.floods += 1
        if self.floods == 1:
            _LOG.warning(
                "%d datagrams of no use at once: another program floods the ports of %s:%d "
                "(%d from strangers)",
                _MOST_WASTED,
                *self._address,
                self.strangers,
            )

    @property
    def overflowed(self) -> int:
        """Datagrams that the ports lost because they were not read."""
        return sum(getattr(port, "overflowed", 0) for port in self._ports)

    def _send(self, data: bytes) -> None:
        try:
            self._ports[0].send(data, self._address)
        except OSError as error:
            _LOG.debug("a request to %s:%d did not leave (%s)", *self._address, error)

    def _take(self, datagram: Datagram) -> tuple[Frame, bool] | None:
        if datagram.sender[0] != self._address[0]:
            self.strangers += 1
            return None
        message, payload = split(datagram.data)
        if message == _FRAME:
            return self._frame(payload, datagram)
        if datagram.sender != self._address:
            self.strangers += 1
        elif message == Message.SERVER_INFO:
            self.server = parse_server_info(payload)
            if not self._agreed:
                self.version = self.server.version
        elif message == Message.RESPONSE and self._asked is not None:
            if payload[:4] == bytes(4):
                self.version, self._agreed = self._asked, True
        elif message == Message.MODELS and self.server is not None:
            self.bodies = parse_models(payload, self.version)
            if isinstance(self._config.body, str):
                ids = [i for i, name in self.bodies.items() if name == self._config.body]
                self.body_id = ids[0] if ids else None
        return None

    def _frame(self, payload: bytes, datagram: Datagram) -> tuple[Frame, bool] | None:
        if self.body_id is None or self.server is None:
            return None
        number = frame_number(payload)
        last = self._number
        if number == last:
            self.repeated += 1
            return None
        if self._stranger(datagram):
            self.strangers += 1
            return None
        parser = self._parser
        if parser is None or (parser.version, parser.body_id) != (self.version, self.body_id):
            parser = self._parser = FrameParser(self.version, self.body_id)
        frame = parser.parse(payload)
        if self._seen_before(frame):
            self.repeated += 1
            return None
        silence_ns = datagram.arrived_ns - self._source_ns
        self._source, self._source_ns = datagram.sender, datagram.arrived_ns
        back = 0 if last is None else last - number
        if 0 < back < _OLD_FRAMES and silence_ns < _RESTART_NS:
            self.repeated += 1
            return None
        self._number = number
        if frame.models_changed:
            self.ask_models()
        return frame, back > 0

    def _seen_before(self, frame: Frame) -> bool:
        """Whether a frame has been received before, perhaps by the other port and much earlier.

        A server that has restarted repeats numbers, not times.
        """
        seen, number = self._seen, frame.number
        times = (frame.timestamp_s, frame.exposure_ticks, frame.sent_ticks)
        if any(times) and seen.get(number) == times:
            return True
        seen[number] = times
        if len(seen) > _OLD_FRAMES:
            del seen[next(iter(seen))]
        return False

    def _stranger(self, datagram: Datagram) -> bool:
        """Frames come from one source; another one counts only when that has been silent."""
        if self._source is None or datagram.sender == self._source:
            return False
        return datagram.arrived_ns - self._source_ns < _OTHER_SOURCE_AFTER_NS
