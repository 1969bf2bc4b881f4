"""A bench's connection to the keeper's process: asked one thing at a time, and never waited for."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping

from hil.drivers.adhesion.keeper.door import MOST_BYTES, peer

Request = Mapping[str, object]


class Link:
    """One connection.

    Args:
        connection: to the keeper.
        t_ns: now.

    Attributes:
        since_ns: when it began; `answered_ns` when the keeper last answered.
        asked: what it has not answered yet.
        uid: the user that the keeper runs as.
    """

    def __init__(self, connection: socket.socket, t_ns: int) -> None:
        connection.setblocking(False)
        self._socket = connection
        self.since_ns = self.answered_ns = t_ns
        self.asked: Request | None = None
        self.uid = peer(connection).uid

    def ask(self, request: Request) -> None:
        """Ask, unless an answer is awaited; raises `OSError` where the keeper has hung up."""
        if self.asked is None:
            self.asked = request
            self._socket.send(json.dumps(request).encode())

    def answer(self, t_ns: int) -> tuple[Request, bytes] | None:
        """What was asked and its answer, once; None before it has come.

        Raises:
            OSError: the keeper has hung up (ConnectionResetError), or cannot be reached.
        """
        if self.asked is None:
            return None
        try:
            packet = self._socket.recv(MOST_BYTES)
        except BlockingIOError:
            return None
        if not packet:
            raise ConnectionResetError("the keeper has hung up")
        asked, self.asked, self.answered_ns = self.asked, None, t_ns
        return asked, packet

    def close(self) -> None:
        """Hang up."""
        self._socket.close()
