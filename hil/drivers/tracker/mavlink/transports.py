"""Transports to the odometry source: UDP, or a serial port that is polled often enough for time stamps."""

import contextlib
import errno
import socket
from collections import deque

from hil.config.mavlink import MavlinkTrackerConfig, UdpAddress, udp_address
from hil.core.clock import Clock
from hil.core.errors import DeviceError, reason_of
from hil.links.mavlink.transport_interface import Address, Arrival, Link
from hil.links.serial_port import PortLostError, SerialPort
from hil.links.udp_ports import UdpPort

_LOOK_NS = 1_000_000
_GONE_AFTER = 20
_PIECES = 4096


def open_link(config: MavlinkTrackerConfig, clock: Clock, device: str) -> Link:
    """The link that the configuration names; raises `DeviceError` when it cannot be opened."""
    address = udp_address(config.port)
    return SerialLink(config, clock, device) if address is None else UdpLink(address, clock, device)


class UdpLink(Link):
    """A UDP port; arrivals are stamped by its thread."""

    datagrams = True
    trouble = ""

    def __init__(self, address: UdpAddress, clock: Clock, device: str) -> None:
        url = ":".join(map(str, address))
        self.peer: Address | None = None
        try:
            if address.role == "udpout":
                self.peer = (socket.gethostbyname(address.host), address.port)
                port = UdpPort(clock, None, 0)
            else:
                port = UdpPort(clock, None, address.port, address.host)
            self._port = port
        except OSError as error:
            raise DeviceError(
                device,
                f"the UDP port cannot be used ({reason_of(error)})",
                port=url,
                expected="udpin with a free port of this host, or udpout with the sender's address",
                remedy=_remedy(error, address.port),
            ) from None

    @property
    def overflowed(self) -> int:  # type: ignore[override]
        """Datagrams lost because they were not taken in time."""
        return self._port.overflowed

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram."""
        with contextlib.suppress(OSError):
            self._port.send(data, address)

    def receive(self) -> Arrival | None:
        """The oldest datagram."""
        found = self._port.receive()
        return None if found is None else Arrival(found.data, found.arrived_ns, found.sender)

    def close(self) -> None:
        """Close the socket."""
        with contextlib.suppress(OSError):
            self._port.close()


def _remedy(error: OSError, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"end the program that holds it (`ss -lunp sport = :{port}` names it: a ground station, or a "
            "MAVLink router), or have the sender send to another port and set tracker.port"
        )
    return "check tracker.port"


class SerialLink(Link):
    """A serial port, polled every millisecond in the background, so that arrivals have a time."""

    datagrams = False

    def __init__(self, config: MavlinkTrackerConfig, clock: Clock, device: str) -> None:
        self._clock = clock
        self._sender: Address = (config.port, 0)
        self.peer = self._sender
        self._arrived: deque[Arrival] = deque(maxlen=_PIECES)
        self.trouble, self.overflowed, self._failures = "", 0, 0
        self._port = SerialPort(device, config.port, config.baud, expected="a sender of MAVLink")
        self._end = clock.schedule(self._look, clock.now_ns())

    @property
    def gone(self) -> bool:  # type: ignore[override]
        """Whether the last 20 polls of the port have failed."""
        return self._failures >= _GONE_AFTER

    def send(self, data: bytes, address: Address) -> None:
        """Write bytes to the port."""
        with contextlib.suppress(PortLostError):
            self._port.write(data)

    def receive(self) -> Arrival | None:
        """The oldest bytes."""
        return self._arrived.popleft() if self._arrived else None

    def close(self) -> None:
        """Stop polling and close the port."""
        self._end()
        self._port.close()

    def _look(self, now_ns: int) -> int:
        try:
            data = self._port.read_available()
            self.trouble, self._failures = "", 0
        except PortLostError as error:
            data, self.trouble = b"", error.what
            self._failures += 1
        arrived_ns = self._clock.now_ns()
        if data:
            self.overflowed += len(self._arrived) == _PIECES
            self._arrived.append(Arrival(data, arrived_ns, self._sender))
        return arrived_ns + _LOOK_NS
