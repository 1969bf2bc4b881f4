"""The network between an emulated capture server and a driver in the same process, in world time.

It has the datagram ports that the driver opens (group or None, number or 0), but uses no socket.
"""

from __future__ import annotations

import errno
from abc import abstractmethod
from collections import deque
from typing import NamedTuple, Protocol

from hil.fakes.world import World

Address = tuple[str, int]

_HOST = "127.0.0.1"
_FIRST_FREE_PORT = 49152


class Arrival(NamedTuple):
    """One datagram at its destination."""

    data: bytes
    sender: Address
    arrived_ns: int


class PacketNetwork(Protocol):
    """A network that carries packets of the server."""

    @abstractmethod
    def joined(self, group: str) -> bool:
        """Whether a client on this network listens to a multicast group."""

    @abstractmethod
    def deliver(self, ready_ns: int, data: bytes, destination: Address) -> None:
        """Send one packet, not before `ready_ns`."""


class Served(Protocol):
    """Interface of a server for its network; `command_port` receives requests."""

    command_port: int

    @abstractmethod
    def receive(self, data: bytes, client: Address, outlet: PacketNetwork, t_ns: int) -> None:
        """Handle one request of `client`, received on `outlet`."""


class WorldPort:
    """A bound port; datagrams sent to it can be received from their arrival time on."""

    def __init__(self, network: WorldNetwork, group: str | None, number: int) -> None:
        self._network = network
        self.group, self.number = group, number
        self.queue: deque[Arrival] = deque()

    def send(self, data: bytes, address: Address) -> None:
        """Send a datagram to the server; raises `OSError` when the port is closed."""
        self._network.send(self, data, address)

    def receive(self) -> Arrival | None:
        """Return the oldest datagram that has arrived, or None."""
        queue = self.queue
        if queue and queue[0].arrived_ns <= self._network.world.now_ns:
            return queue.popleft()
        return None

    def close(self) -> None:
        """Release the port number."""
        self._network.forget(self)


class WorldNetwork(PacketNetwork):
    """Network between one client host and one server.

    Args:
        server: server on the network.
        world: source of the time.
    """

    def __init__(self, server: Served, world: World) -> None:
        self._server, self.world = server, world
        self._ports: list[WorldPort] = []
        self._server_host = _HOST
        self._next = _FIRST_FREE_PORT

    def open(self, group: str | None, number: int) -> WorldPort:
        """Open a port; raises `OSError` if its number is taken (multicast groups can be shared)."""
        if number == 0:
            number, self._next = self._next, self._next + 1
        if group is None and any(p.number == number and p.group is None for p in self._ports):
            raise OSError(errno.EADDRINUSE, f"port {number} is in use")
        port = WorldPort(self, group, number)
        self._ports.append(port)
        return port

    def forget(self, port: WorldPort) -> None:
        """Close a port. Idempotent."""
        self._ports = [p for p in self._ports if p is not port]

    def send(self, port: WorldPort, data: bytes, address: Address) -> None:
        """Send a request to the server's command port; raises `OSError` if `port` is closed."""
        if port not in self._ports:
            raise OSError(errno.EBADF, "the port is closed")
        if address[1] == self._server.command_port:
            self._server_host = address[0]
            self._server.receive(data, (_HOST, port.number), self, self.world.now_ns)

    def joined(self, group: str) -> bool:
        """Whether an open port listens to the group."""
        return any(port.group == group for port in self._ports)

    def deliver(self, ready_ns: int, data: bytes, destination: Address) -> None:
        """Queue a datagram of the server at the ports that receive it; the order is kept."""
        host, number = destination
        sender = (self._server_host, self._server.command_port)
        for port in self._ports:
            if port.number == number and host == (_HOST if port.group is None else port.group):
                last_ns = port.queue[-1].arrived_ns if port.queue else 0
                arrived_ns = ready_ns if ready_ns > last_ns else last_ns
                port.queue.append(Arrival(data, sender, arrived_ns))
