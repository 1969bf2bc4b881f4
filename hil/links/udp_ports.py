"""The interface of datagram ports, and its implementation on UDP.

A port stamps every arrival, because datagrams wait between two reads. The real port does that in a thread
of its own, which does nothing else. A flood takes a bounded share of that thread's time: what comes faster
than any capture system sends waits in the kernel, which drops the rest.
"""

import contextlib
import socket
import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias

from hil.core.clock import NS_PER_S, Clock

Address: TypeAlias = tuple[str, int]

_LARGEST = 65535
_POLL_S = 0.1
_QUEUE = 1024
_WINDOW_NS = 5_000_000
_MOST_PER_WINDOW = 128


class Datagram(NamedTuple):
    """One datagram: its bytes, its sender, and when it arrived on the bench clock."""

    data: bytes
    sender: Address
    arrived_ns: int


class DatagramPort(Protocol):
    """One bound UDP port."""

    @abstractmethod
    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram; raises `OSError` when it cannot leave the host."""

    @abstractmethod
    def receive(self) -> Datagram | None:
        """The oldest datagram that has arrived, or None; never waits."""

    @abstractmethod
    def close(self) -> None:
        """Close the port. Idempotent."""


DatagramFactory: TypeAlias = Callable[[str | None, int], DatagramPort]
"""(multicast group to join or None, port number or 0 for any) -> open port; raises `OSError`."""


class UdpPort(DatagramPort):
    """A UDP socket whose arrivals are stamped by a thread.

    Args:
        clock: the bench clock.
        group: multicast group to join.
        port: number to bind, 0 for any.
        interface: local IPv4 address; any when empty.

    Attributes:
        received: datagrams taken from the kernel.
        overflowed: datagrams lost because they were not read in time.
    """

    def __init__(self, clock: Clock, group: str | None, port: int, interface: str = "") -> None:
        self._clock = clock
        self._queue: deque[Datagram] = deque(maxlen=_QUEUE)
        self._stopping = threading.Event()
        self.received = self.overflowed = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._bind(group, port, interface)
        except BaseException:
            self._socket.close()
            raise
        self._thread = threading.Thread(target=self._listen, name="mocap-udp", daemon=True)
        self._thread.start()

    def send(self, data: bytes, address: Address) -> None:
        """Send one datagram."""
        self._socket.sendto(data, address)

    def receive(self) -> Datagram | None:
        """The oldest datagram that has arrived."""
        return self._queue.popleft() if self._queue else None

    def close(self) -> None:
        """Stop listening and close the socket."""
        self._stopping.set()
        self._thread.join()
        self._socket.close()

    def _bind(self, group: str | None, port: int, interface: str) -> None:
        self._socket.settimeout(_POLL_S)
        if group is None:
            self._socket.bind((interface, port))
            return
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind((group, port))
        membership = socket.inet_aton(group) + socket.inet_aton(interface or "0.0.0.0")
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)

    def _listen(self) -> None:
        window_ns, taken = self._clock.now_ns(), 0
        while not self._stopping.is_set():
            with contextlib.suppress(OSError):
                data, sender = self._socket.recvfrom(_LARGEST)
                now_ns = self._clock.now_ns()
                self.received += 1
                self.overflowed += len(self._queue) == _QUEUE
                self._queue.append(Datagram(data, sender, now_ns))
                if now_ns - window_ns >= _WINDOW_NS:
                    window_ns, taken = now_ns, 0
                taken += 1
                if taken >= _MOST_PER_WINDOW:
                    self._stopping.wait((window_ns + _WINDOW_NS - now_ns) / NS_PER_S)


def udp_ports(clock: Clock, interface: str = "") -> DatagramFactory:
    """A factory of real ports on one interface (any when empty)."""

    def open_port(group: str | None, port: int) -> DatagramPort:
        return UdpPort(clock, group, port, interface)

    return open_port
