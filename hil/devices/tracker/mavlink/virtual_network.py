"""The network between the emulated computer and a driver in the same process, in world time."""

from __future__ import annotations

from collections import deque

from hil.core.clock import Clock, nanoseconds
from hil.devices.tracker.mavlink.config import MavlinkTrackerConfig
from hil.devices.tracker.mavlink.emulated_computer import Outlet, VisualInertialComputer
from hil.devices.tracker.mavlink.transport_interface import Address, Arrival, Link

_ADDRESS = ("127.0.0.1", 14550)


class WorldLink(Link, Outlet):
    """A cable with datagrams; both ways take the computer's `network_s`.

    Its shape is that of the links to real senders: `MavlinkTracker(..., link=ComputerLink(computer))`.
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
        if not computer.faults.cut_off(computer.now_ns):
            computer.hear(data, computer.now_ns + self._transit_ns, self)

    def receive(self) -> Arrival | None:
        """The oldest datagram that has arrived."""
        coming = self._coming
        return coming.popleft() if coming and coming[0].arrived_ns <= self._computer.now_ns else None

    def close(self) -> None:
        """Pull the cable."""
        self._computer.detach(self)

    def deliver(self, packet: bytes, t_ns: int) -> None:
        """Put a datagram on its way to the driver."""
        for data in self._computer.faults.spoil(packet, t_ns):
            self._coming.append(Arrival(data, t_ns + self._transit_ns, _ADDRESS))

    @property
    def _transit_ns(self) -> int:
        return nanoseconds(self._computer.options.network_s)


class ComputerLink:
    """Opens links to one computer, as the driver asks for them."""

    def __init__(self, computer: VisualInertialComputer) -> None:
        self._computer = computer

    def __call__(self, config: MavlinkTrackerConfig, clock: Clock, device: str) -> Link:
        """Make a new cable between driver and emulated computer."""
        return WorldLink(self._computer)
