"""Serves the emulated capture system on real UDP sockets, unicast and multicast, for any NatNet client."""

import contextlib
import errno
import heapq
import itertools
import socket
import sys
from pathlib import Path

from hil.core.errors import DeviceError, reason_of
from hil.fakes.free_port import free_udp_port
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.mocap.natnet.virtual_network import Address, PacketNetwork
from hil.fakes.udp_server import DatagramTransport
from hil.fakes.world import NEVER_NS
from hil.support.port_users import ending, named, programs_with_udp

_LARGEST = 65535
_GROUPS = Path("/proc/net/igmp")


def _cannot_serve(device: str, host: str, port: int, error: OSError) -> DeviceError:
    remedy = "choose another host or command port"
    if error.errno == errno.EADDRINUSE:
        users = programs_with_udp(port)
        free_it = (
            f"end {named(users)}{ending(users)}"
            if users
            else (
                f"end the program that holds it (`ss -lunp sport = :{port}` names it: an emulator, or Motive)"
            )
        )
        remedy = f"{free_it}, or choose another mocap.command_port"
    return DeviceError(
        device,
        f"the emulated capture server cannot be served ({reason_of(error)})",
        port=f"{host}:{port}",
        expected="a local IPv4 address and a free UDP port",
        remedy=remedy,
    )


class NatNetTransport(DatagramTransport, PacketNetwork):
    """One server on one UDP socket.

    Args:
        server: the emulated capture system.
        host: local IPv4 address to serve on; multicast is sent through it and never leaves the host.
        command_port, data_port: port numbers; 0 takes free ones. They replace those of the server.

    Raises:
        DeviceError: the command port cannot be used. (The data port belongs to the clients.)
    """

    def __init__(
        self, server: NatNetServer, *, host: str = "127.0.0.1", command_port: int = 0, data_port: int = 0
    ) -> None:
        self._server = server
        self._coming: list[tuple[int, int, bytes, Address]] = []
        self._order = itertools.count()
        try:
            super().__init__(host, command_port)
            server.data_port = data_port or free_udp_port(host)
        except OSError as error:
            raise _cannot_serve(server.name, host, command_port, error) from None
        server.command_port = self.port
        server.attach(self)

    def _bind(self, host: str, port: int) -> None:
        super()._bind(host, port)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)

    def next_due_ns(self) -> int:
        """Time at which the next packet is sent."""
        return self._coming[0][0] if self._coming else NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Send the packets that are due; those that the network rejects are lost."""
        while self._coming and self._coming[0][0] <= t_ns:
            _, _, data, destination = heapq.heappop(self._coming)
            self.transmit(data, destination)

    def joined(self, group: str) -> bool:
        """Whether a program of this host listens to the group (all clients are here); False if unknown."""
        number = f"{int.from_bytes(socket.inet_aton(group), sys.byteorder):08X}"
        with contextlib.suppress(OSError):
            return number in _GROUPS.read_text(encoding="ascii").split()
        return False

    def deliver(self, ready_ns: int, data: bytes, destination: Address) -> None:
        """Queue one packet."""
        heapq.heappush(self._coming, (ready_ns, next(self._order), data, destination))

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Pass one request to the server."""
        taken = self.receive(_LARGEST)
        if taken is not None:
            data, client = taken
            self._server.receive(data, client, self, t_ns)

    def endpoint(self) -> dict[str, object]:
        """Addresses with which a client reaches the server."""
        return {
            "server": self.host,
            "command_port": self._server.command_port,
            "data_port": self._server.data_port,
            "multicast": self._server.multicast,
        }

    def close(self) -> None:
        """Stop serving. Idempotent."""
        self._server.detach(self)
        self._coming.clear()
        super().close()
