"""A transport on one UDP socket, which answers and passes on, and plans nothing of its own."""

from __future__ import annotations

import contextlib
import socket

from hil.fakes.server import Transport
from hil.fakes.world import NEVER_NS


class DatagramTransport(Transport):
    """An open UDP socket that never blocks; what its datagrams mean is up to the device.

    Args:
        host, port: where to listen; port 0 takes a free one.

    Attributes:
        host, port: where it listens.

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
        """Nothing is planned here: what the device says is passed on as it comes."""
        return NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Nothing is ever due."""

    def filenos(self) -> list[int]:
        """The socket, while open."""
        number = self._socket.fileno()
        return [] if number < 0 else [number]

    def close(self) -> None:
        """Stop serving. Idempotent."""
        self._socket.close()

    def receive(self, largest: int) -> tuple[bytes, tuple[str, int]] | None:
        """One datagram and its sender; None when there is none, or the socket is closed.

        Args:
            largest: bytes of it that are taken.
        """
        try:
            data, (host, port) = self._socket.recvfrom(largest)
        except OSError:
            return None
        return data, (host, port)

    def transmit(self, data: bytes, client: tuple[str, int]) -> None:
        """Send a datagram; what the network refuses, or a closed socket, is lost."""
        with contextlib.suppress(OSError):
            self._socket.sendto(data, client)
