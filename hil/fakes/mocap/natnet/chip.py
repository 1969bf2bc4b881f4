"""The emulated Motive server: frames of rigid bodies at its own rate and clock, replies to NatNet requests.

Unicast clients are those that have connected or sent a keep-alive recently. Frames go to the port from which
a client sends and, for the newest client of a host, to its data port: public clients expect either. A client
that has joined the multicast group offered in addition gets each frame once.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import UsageError
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.mocap.natnet import encoding as natnet_encoding
from hil.fakes.mocap.natnet.camera_view import CaptureVolume, SeenBody
from hil.fakes.mocap.natnet.faults import SUPPORTED_FAULTS, MocapFaults
from hil.fakes.mocap.natnet.true_parameters import MocapTruthOptions
from hil.fakes.mocap.natnet.virtual_network import Address, PacketNetwork, WorldNetwork, WorldPort
from hil.fakes.world import Scheduled, World
from hil.faults.fault import OUT

__all__ = ["SUPPORTED_FAULTS", "NatNetServer"]

CLOCK_HZ = 10_000_000
_FORGET_NS = nanoseconds(10.0)
_BOOT_NS = nanoseconds(0.3)
_ANSWER_NS = nanoseconds(0.0002)
_RECEIVED_SHARE = 0.4
_HEAD = struct.Struct("<HH")
_BITSTREAM = slice(265, 267)
"""Part of a connection request that holds the version requested by the client, after its own description."""


@dataclass
class Client:
    """A connected client.

    Attributes:
        outlet: network of the client.
        version: bit stream version of its frames.
        heard_ns: time of its last request.
        by_unicast: True if frames go to it by unicast. With a multicast group offered in addition, they do so
            only if it is known that the client does not listen to the group.
    """

    outlet: PacketNetwork
    version: tuple[int, int]
    heard_ns: int
    by_unicast: bool


class NatNetServer(Scheduled):
    """NatNet server with its clients, cameras and faults.

    Args:
        world: truth, seed and faults; the server registers itself there.
        name: device name of its faults.
        options: true imperfections.
        body, body_id: name and streaming id of the robot's rigid body.
        up_axis: streaming setting.
        version: NatNet version of the server, one of 3.1, 4.0, 4.1.
        command_port, data_port: port numbers.
        multicast: group to which frames are sent; None for unicast.

    Attributes:
        malformed: number of requests that were too short for a NatNet packet.
        offered_group: multicast group to which a unicast server also sends its frames; None for none.
    """

    Options = MocapTruthOptions
    announces = True

    @classmethod
    def build(cls, request: EmulationRequest) -> NatNetServer:
        """Make the server, with the rigid body that the bench expects, from its table of the bench file."""
        config = request.config
        body = {"body": config.body} if isinstance(config.body, str) else {"body_id": config.body}
        options = request.options(cls.Options)
        major, minor = map(int, options.natnet.split("."))
        return cls(
            request.world,
            name=request.kind,
            options=options,
            version=(major, minor),
            up_axis=config.up_axis,
            command_port=config.command_port,
            data_port=config.data_port,
            multicast=config.multicast,
            **body,
        )

    def __init__(
        self,
        world: World,
        name: str = "mocap",
        options: MocapTruthOptions | None = None,
        *,
        body: str = "robot",
        body_id: int = 1,
        up_axis: Literal["y", "z"] = "y",
        version: tuple[int, int] = (4, 1),
        command_port: int = 1510,
        data_port: int = 1511,
        multicast: str | None = None,
    ) -> None:
        if version not in natnet_encoding.VERSIONS:
            raise UsageError(
                f"the emulated server does not speak NatNet {version}", expected="3.1, 4.0 or 4.1"
            )
        self.name = name
        self.command_port, self.data_port, self.multicast = command_port, data_port, multicast
        self.malformed = 0
        self._world, self._version = world, version
        self._options = options if options is not None else MocapTruthOptions()
        self._rng = world.rng(name)
        self._faults = MocapFaults(world.faults, name, self._rng)
        own = world.rng(f"{name} under way")
        self._volume = CaptureVolume(self._options, self._rng, own, (body, body_id), up_axis)
        self._stretch = 1.0 + 1e-6 * self._options.clock_ppm * float(self._rng.standard_normal())
        self._latency_ticks = round(self._options.latency_s * CLOCK_HZ)
        self._receive_ticks = round(_RECEIVED_SHARE * self._latency_ticks)
        self._frames = natnet_encoding.Frames()
        self._network = WorldNetwork(self, world)
        self._outlets: list[PacketNetwork] = [self._network]
        self.offered_group: str | None = None
        self._clients: dict[Address, Client] = {}
        self._arrived_ns = 0
        self._last: tuple[int, tuple[SeenBody, ...], natnet_encoding.FrameTimes] | None = None
        self._start(-round(float(self._rng.uniform(100.0, 10_000.0)) * NS_PER_S))
        self._due_ns = int(self._rng.integers(0, round(NS_PER_S / self._options.rate_hz)))
        world.add(self)

    @property
    def now_ns(self) -> int:
        """World time, ns."""
        return self._world.now_ns

    def datagrams(self, group: str | None, port: int) -> WorldPort:
        """Open a datagram port on the server's network in this process; the driver's `datagrams` factory."""
        return self._network.open(group, port)

    def attach(self, outlet: PacketNetwork) -> None:
        """Add a network to which multicast frames are sent."""
        self._outlets.append(outlet)

    def detach(self, outlet: PacketNetwork) -> None:
        """Remove a network and its clients."""
        self._outlets = [o for o in self._outlets if o is not outlet]
        self._clients = {a: c for a, c in self._clients.items() if c.outlet is not outlet}

    def next_due_ns(self) -> int:
        """Time of the next exposure."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Expose and send one frame."""
        faults, options = None if self._faults.plan.empty else self._faults, self._options
        if faults is not None and faults.restarted(t_ns):
            self._clients.clear()
            self._start(t_ns)
            self._due_ns = t_ns + _BOOT_NS
            return
        period_factor = 1.0 if faults is None else faults.period_factor(t_ns)
        self._due_ns = t_ns + round(NS_PER_S / options.rate_hz / self._stretch * period_factor)
        self._number += 1
        hidden = faults is not None and faults.hidden(t_ns)
        seen = self._volume.see(self._world.plant.body(), t_ns, hidden)
        bodies = seen if faults is None else faults.distort(seen, t_ns)
        stamped_ns = self._volume.late_ns(t_ns)
        self._last = (self._number, bodies, self._times(stamped_ns))
        jitter = self._rng.standard_exponential()
        if self._volume.in_gap(t_ns) or (faults is not None and faults.silent(t_ns)):
            return
        late_s = options.latency_s + options.transit_s + options.jitter_s * jitter
        ready_ns = stamped_ns + nanoseconds(late_s + self._stall_s())
        self._stream(ready_ns if ready_ns > self._arrived_ns else self._arrived_ns, t_ns)

    def receive(self, data: bytes, client: Address, outlet: PacketNetwork, t_ns: int) -> None:
        """Answer one request, if the network lets it through."""
        if self._faults.cut_off(t_ns) or t_ns < self._boot_ns:
            return
        for packet in (data,) if self._faults.plan.empty else self._faults.received(data, t_ns, OUT):
            self._obey(packet, client, outlet, t_ns)

    def _obey(self, data: bytes, client: Address, outlet: PacketNetwork, t_ns: int) -> None:
        if len(data) < _HEAD.size:
            self.malformed += 1
            return
        kind, payload = _HEAD.unpack_from(data)[0], data[_HEAD.size :]  # clients disagree on what size counts
        answer = self._answer(kind, payload, client, outlet, t_ns)
        if answer:
            self._send(answer, client, outlet, t_ns + _ANSWER_NS, t_ns)

    def _start(self, t_ns: int) -> None:
        """Start clock and frame counter of the server (before the world's start if `t_ns` is negative)."""
        self._started_ns, self._boot_ns = t_ns, max(t_ns, 0)
        self._number = round(max(0, -t_ns) * 1e-9 * self._options.rate_hz)
        self._last = None

    def _stall_s(self) -> float:
        options = self._options
        if self._rng.random() < options.stalls_per_s / options.rate_hz:
            return options.longest_stall_s * float(self._rng.random())
        return 0.0

    def _times(self, t_ns: int) -> natnet_encoding.FrameTimes:
        up_s = (t_ns - self._started_ns) * 1e-9 * self._stretch
        exposure = round(up_s * CLOCK_HZ)
        received, sent = exposure + self._receive_ticks, exposure + self._latency_ticks
        return natnet_encoding.FrameTimes(up_s, exposure, received, sent)

    def _stream(self, ready_ns: int, t_ns: int) -> None:
        self._arrived_ns = ready_ns
        packets: dict[tuple[int, int], bytes] = {}
        if (group := self.multicast or self.offered_group) is not None:
            packet = self._frame(self._version, packets)
            for outlet in self._outlets:
                self._send(packet, (group, self.data_port), outlet, ready_ns, t_ns)
        newest: dict[str, tuple[Address, Client]] = {}
        for address, client in tuple(self._clients.items()):
            if t_ns - client.heard_ns > _FORGET_NS:
                del self._clients[address]
            elif client.by_unicast:
                self._send(self._frame(client.version, packets), address, client.outlet, ready_ns, t_ns)
                if address[0] not in newest or client.heard_ns >= newest[address[0]][1].heard_ns:
                    newest[address[0]] = (address, client)
        for (host, port), client in newest.values():
            if port != self.data_port:
                packet = self._frame(client.version, packets)
                self._send(packet, (host, self.data_port), client.outlet, ready_ns, t_ns)

    def _frame(self, version: tuple[int, int], packets: dict[tuple[int, int], bytes]) -> bytes:
        assert self._last is not None
        if version not in packets:
            packets[version] = self._frames.frame(*self._last, version)
        return packets[version]

    def _send(
        self, packet: bytes, destination: Address, outlet: PacketNetwork, ready_ns: int, t_ns: int
    ) -> None:
        faults = self._faults
        if faults.plan.empty:
            outlet.deliver(ready_ns, packet, destination)
        elif not faults.cut_off(t_ns):
            for data in faults.received(packet, t_ns):
                outlet.deliver(ready_ns + faults.lateness_ns(t_ns), data, destination)

    def _answer(self, kind: int, payload: bytes, client: Address, outlet: PacketNetwork, t_ns: int) -> bytes:
        known = self._clients.get(client)
        if kind in (natnet_encoding.CONNECT, natnet_encoding.KEEPALIVE):
            if self.multicast is None:
                self._clients[client] = self._updated(kind, payload, known, outlet, t_ns)
            if kind == natnet_encoding.KEEPALIVE:
                return b""
            return natnet_encoding.server_info(self._version, CLOCK_HZ, self.data_port, self.multicast)
        version = self._version if known is None else known.version
        if kind == natnet_encoding.DISCONNECT:
            self._clients.pop(client, None)
            return b""
        if kind == natnet_encoding.REQUEST_MODELS:
            return natnet_encoding.models(self._volume.names, version)
        if kind == natnet_encoding.REQUEST_FRAME and self._last is not None:
            return self._frame(version, {})
        if kind == natnet_encoding.REQUEST:
            return self._command(payload.split(b"\0")[0].decode("utf-8", "replace"), known)
        return natnet_encoding.message(natnet_encoding.UNRECOGNISED)

    def _updated(
        self, kind: int, payload: bytes, known: Client | None, outlet: PacketNetwork, t_ns: int
    ) -> Client:
        """Return the client after its request; only unicast clients send keep-alives."""
        group, version = self.offered_group, self._version if known is None else known.version
        requested = tuple(payload[_BITSTREAM])
        if (
            kind == natnet_encoding.CONNECT
            and requested in natnet_encoding.VERSIONS
            and requested <= self._version >= (4, 0)
        ):
            version = (requested[0], requested[1])
        alone = group is None or kind == natnet_encoding.KEEPALIVE or not outlet.joined(group)
        return Client(outlet, version, t_ns, alone or (known is not None and known.by_unicast))

    def _command(self, text: str, client: Client | None) -> bytes:
        """Answer a text request: another bit stream (unicast, NatNet 4), frame rate, units."""
        if text == "FrameRate":
            return natnet_encoding.message(natnet_encoding.RESPONSE, struct.pack("<f", self._options.rate_hz))
        if text == "UnitsToMillimeters":
            return natnet_encoding.message(natnet_encoding.RESPONSE, struct.pack("<f", 1000.0))
        versions = {"Bitstream,{}.{}".format(*v): v for v in natnet_encoding.VERSIONS if v <= self._version}
        if text in versions and client is not None and self._version >= (4, 0):
            client.version = versions[text]
            return natnet_encoding.message(natnet_encoding.RESPONSE, bytes(4))
        return natnet_encoding.message(natnet_encoding.UNRECOGNISED)
