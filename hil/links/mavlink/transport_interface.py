"""The interface of a transport of packets between an odometry source and its driver."""

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import Clock

Address: TypeAlias = tuple[str, int]


class Arrival(NamedTuple):
    """Bytes, when they arrived on the bench clock, and where answers go."""

    data: bytes
    arrived_ns: int
    sender: Address


class Link(Protocol):
    """An open link to the sender.

    Attributes:
        datagrams: True if each arrival is a whole datagram.
        peer: address of the other side before it has sent anything; None where that is not known.
        trouble: reason why nothing can arrive any more; empty while all is well.
        gone: True if the trouble has lasted for so long that the link must be opened again.
        overflowed: arrivals lost because they were not taken in time.
    """

    datagrams: bool
    peer: Address | None
    trouble: str
    gone: bool = False
    overflowed: int

    @abstractmethod
    def send(self, data: bytes, address: Address) -> None:
        """Send to an address; what cannot leave is lost."""

    @abstractmethod
    def receive(self) -> Arrival | None:
        """The oldest bytes that have arrived, or None; never waits."""

    @abstractmethod
    def close(self) -> None:
        """Close the link. Idempotent; never raises."""


LinkFactory: TypeAlias = Callable[[MavlinkTrackerConfig, Clock, str], Link]
"""(configuration, bench clock, device name) -> an open link; raises `DeviceError`."""
