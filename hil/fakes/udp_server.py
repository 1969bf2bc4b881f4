"""A transport on one UDP socket; it forwards data at once and has no planned actions."""

import contextlib
import socket

from hil.fakes.server import Transport
from hil.fakes.world import NEVER_NS


class DatagramTransport(Transport):
    """A non-blocking UDP socket; the device defines the contents of the datagrams.

    Args:
        host, port: address to listen on; port 0 takes a free one.

    Attributes:
        host, port: address of the socket.

    Raises:
        OSError: the port cannot be used.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._bind(host, port)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.host, self.port = self._socket.getsockname()[:2]

    def _bind(self, host: str, port: int) -> None:
        self._socket.bind((host, port))

    def next_due_ns(self) -> int:
        """Never: data of the device are sent at once."""
        return NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Do nothing: no action is ever due."""

    def filenos(self) -> list[int]:
        """File descriptor of the socket, while open."""
        number = self._socket.fileno()
        return [] if number < 0 else [number]

    def close(self) -> None:
        """Stop serving. Idempotent."""
        self._socket.close()

    def receive(self, largest: int) -> tuple[bytes, tuple[str, int]] | None:
        """Receive one datagram and its sender; None without one, or if the socket is closed.

        Args:
            largest: number of bytes of it that are read.
        """
        try:
            data, (host, port) = self._socket.recvfrom(largest)
        except OSError:
            return None
        return data, (host, port)

    def transmit(self, data: bytes, client: tuple[str, int]) -> None:
        """Send a datagram; it is lost if the network rejects it or the socket is closed."""
        with contextlib.suppress(OSError):
            self._socket.sendto(data, client)
