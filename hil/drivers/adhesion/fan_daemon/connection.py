"""A bench's connection to the daemon: one request at a time, without ever waiting."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping

from hil.drivers.adhesion.fan_daemon.server import MOST_BYTES, peer

Request = Mapping[str, object]


class Connection:
    """A non-blocking connection.

    Args:
        connection: to the daemon.
        t_ns: now.

    Attributes:
        since_ns: when it began; `answered_ns` when the daemon last answered.
        asked: the request that is not answered yet.
        uid: the user that the daemon runs as.
    """

    def __init__(self, connection: socket.socket, t_ns: int) -> None:
        connection.setblocking(False)
        self._socket = connection
        self.since_ns = self.answered_ns = t_ns
        self.asked: Request | None = None
        self.uid = peer(connection).uid

    def ask(self, request: Request) -> None:
        """Send a request, unless an answer is awaited; raises `OSError` where the daemon has hung up."""
        if self.asked is None:
            self.asked = request
            self._socket.send(json.dumps(request).encode())

    def answer(self, t_ns: int) -> tuple[Request, bytes] | None:
        """(request, answer), once; None before it has come.

        Raises:
            OSError: the daemon has hung up (ConnectionResetError), or cannot be reached.
        """
        if self.asked is None:
            return None
        try:
            packet = self._socket.recv(MOST_BYTES)
        except BlockingIOError:
            return None
        if not packet:
            raise ConnectionResetError("the daemon has hung up")
        asked, self.asked, self.answered_ns = self.asked, None, t_ns
        return asked, packet

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
