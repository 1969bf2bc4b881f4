"""Transports of the emulated computer: in world time a serial line or datagrams, in real time UDP.

On real UDP it serves any MAVLink program. It streams to a fixed address, like a computer with a configured
ground station, and to every program that has sent to it in the last 5 s.
"""

from __future__ import annotations

from collections import deque

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, reason_of
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.tracker.mavlink.chip import Outlet, VisualInertialComputer
from hil.fakes.tracker.mavlink.faults import OWN_FAULTS
from hil.fakes.udp_server import DatagramTransport
from hil.fakes.world import NEVER_NS
from hil.faults.fault import OUT, Supported
from hil.links.mavlink.transport_interface import Address, Arrival, Link

_FORGET_NS = nanoseconds(5.0)
_LARGEST = 65535
_NOISE = 0x55
_ADDRESS = ("127.0.0.1", 14550)


class _Client(Outlet):
    """A program that the stream is sent to."""

    def __init__(self, transport: MavlinkTransport, address: Address, heard_ns: int) -> None:
        self._transport, self.address, self.heard_ns = transport, address, heard_ns

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Send a packet, unless the client has been silent for 5 s."""
        self._transport.send(packet, self, t_ns)


class MavlinkTransport(DatagramTransport):
    """One computer on one UDP socket.

    Args:
        computer: the emulated computer.
        host, port: address at which it receives; port 0 takes a free one.
        target: address that it streams to without a request.

    Raises:
        DeviceError: the port cannot be used.
    """

    def __init__(
        self,
        computer: VisualInertialComputer,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        target: Address | None = None,
    ) -> None:
        self._computer = computer
        self._clients: dict[Address, _Client] = {}
        try:
            super().__init__(host, port)
        except OSError as error:
            raise DeviceError(
                computer.name,
                f"the emulated computer cannot be served ({reason_of(error)})",
                port=f"{host}:{port}",
                expected="a local IPv4 address and a free UDP port",
                remedy="choose another one",
            ) from None
        if target is not None:
            self._client(target, NEVER_NS)

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Take one datagram; its sender gets the stream from now on."""
        taken = self.receive(_LARGEST)
        if taken is None:
            return
        data, address = taken
        for packet in self._computer.faults.received(data, t_ns, OUT):
            self._computer.hear(packet, t_ns, self._client(address, t_ns))

    def send(self, packet: bytes, client: _Client, t_ns: int) -> None:
        """Send a packet as the network leaves it; what the network refuses is lost."""
        if t_ns - client.heard_ns > _FORGET_NS:
            self._forget(client)
            return
        for data in self._computer.faults.received(packet, t_ns):
            self.transmit(data, client.address)

    def endpoint(self) -> dict[str, object]:
        """How a client reaches the computer."""
        options = self._computer.options
        ids = {"system_id": options.system_id, "component_id": options.component_id}
        return {"port": f"udpout:{self.host}:{self.port}", **ids}

    def close(self) -> None:
        """Stop serving. Idempotent."""
        for client in tuple(self._clients.values()):
            self._forget(client)
        super().close()

    def _client(self, address: Address, t_ns: int) -> _Client:
        client = self._clients.get(address)
        if client is None:
            client = self._clients[address] = _Client(self, address, t_ns)
            self._computer.attach(client)
        client.heard_ns = max(client.heard_ns, t_ns)
        return client

    def _forget(self, client: _Client) -> None:
        self._computer.detach(client)
        self._clients.pop(client.address, None)


class SerialComputer(SerialChip, Outlet):
    """One computer at the far end of a serial line; its cable's faults are the line's.

    It begins to send once it has received something: before that the line has no baud rate.

    Args:
        computer: the emulated computer.
        baud: its bits per second.
    """

    def __init__(self, computer: VisualInertialComputer, *, baud: int) -> None:
        self.name = computer.name
        self.supported_faults: Supported = OWN_FAULTS
        self._computer, self._baud = computer, baud
        self._baud_matches = True
        self._leaving: list[Reply] = []

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Take bytes from the other end; at another baud rate they are noise."""
        self._baud_matches = baud == self._baud
        self._computer.attach(self)
        if self._baud_matches:
            self._computer.hear(data, t_ns, self)
        return []

    def reset(self, t_ns: int) -> None:
        """Do nothing: the computer is not powered by the line."""

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Put a packet on the line."""
        data = packet if self._baud_matches else bytes(byte ^ _NOISE for byte in packet)
        self._leaving.append(Reply(t_ns, data))

    def poll(self, t_ns: int) -> list[Reply]:
        """Packets that the computer has sent since the last call."""
        leaving, self._leaving = self._leaving, []
        return leaving

    def next_poll_ns(self) -> int:
        """Time of the oldest packet that waits; `NEVER_NS` for none."""
        return self._leaving[0].ready_ns if self._leaving else NEVER_NS


class WorldLink(Link, Outlet):
    """A link by datagrams in memory; each way takes the computer's `network_s`.

    It has the interface of a link to a real sender: `MavlinkTracker(..., link=ComputerLink(computer))`.
    """

    datagrams = True
    peer: Address | None = _ADDRESS
    trouble = ""
    overflowed = 0

    def __init__(self, computer: VisualInertialComputer) -> None:
        self._computer = computer
        self._coming: deque[Arrival] = deque()
        computer.attach(self)

    def send(self, data: bytes, address: Address) -> None:
        """Send a datagram to the computer."""
        computer = self._computer
        for packet in computer.faults.received(data, computer.now_ns, OUT):
            computer.hear(packet, computer.now_ns + self._transit_ns, self)

    def receive(self) -> Arrival | None:
        """The oldest datagram that has arrived."""
        coming = self._coming
        return coming.popleft() if coming and coming[0].arrived_ns <= self._computer.now_ns else None

    def close(self) -> None:
        """Detach from the computer."""
        self._computer.detach(self)

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Put a datagram on its way to the driver."""
        for data in self._computer.faults.received(packet, t_ns):
            self._coming.append(Arrival(data, t_ns + self._transit_ns, _ADDRESS))

    @property
    def _transit_ns(self) -> int:
        return nanoseconds(self._computer.options.network_s)


class ComputerLink:
    """Factory of links to one computer, for the driver."""

    def __init__(self, computer: VisualInertialComputer) -> None:
        self._computer = computer

    def __call__(self, config: MavlinkTrackerConfig, clock: Clock, device: str) -> Link:
        """Make a new link between driver and emulated computer."""
        return WorldLink(self._computer)
