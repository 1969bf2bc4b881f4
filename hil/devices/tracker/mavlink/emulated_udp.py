"""Serves the emulated visual-inertial computer on real UDP, to any MAVLink program.

It streams to a fixed address, as a computer does that knows its ground station, and to every program that
has spoken to it in the last seconds.
"""

from __future__ import annotations

from hil.core.clock import nanoseconds
from hil.core.errors import DeviceError, reason_of
from hil.devices.tracker.mavlink.emulated_computer import Outlet, VisualInertialComputer
from hil.devices.tracker.mavlink.transport_interface import Address
from hil.fakes.udp_server import DatagramTransport
from hil.fakes.world import NEVER_NS

_FORGET_NS = nanoseconds(5.0)
_LARGEST = 65535


class _Client(Outlet):
    """A program that the stream is sent to."""

    def __init__(self, transport: MavlinkTransport, address: Address, heard_ns: int) -> None:
        self._transport, self.address, self.heard_ns = transport, address, heard_ns

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Send a packet, unless the listener has long been silent."""
        self._transport.send(packet, self, t_ns)


class MavlinkTransport(DatagramTransport):
    """One computer on one UDP socket.

    Args:
        computer: the emulated computer.
        host, port: where it can be spoken to; port 0 takes a free one.
        target: where it streams unasked.

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
        """Take one datagram; its sender is a listener from now on."""
        taken = self.receive(_LARGEST)
        if taken is None:
            return
        data, address = taken
        if not self._computer.faults.cut_off(t_ns):
            self._computer.hear(data, t_ns, self._client(address, t_ns))

    def send(self, packet: bytes, client: _Client, t_ns: int) -> None:
        """Send a packet as the network leaves it; what the network refuses is lost."""
        if t_ns - client.heard_ns > _FORGET_NS:
            self._forget(client)
            return
        for data in self._computer.faults.spoil(packet, t_ns):
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
