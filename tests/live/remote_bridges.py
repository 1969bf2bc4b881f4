"""Serial servers as they stand on a bench elsewhere: a PTY behind TCP, raw or RFC 2217, with latency."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections import deque

import serial
from serial import rfc2217


class NoModemLines(serial.Serial):
    """A PTY as a serial port: it has no modem lines to ask for or to set."""

    cts = dsr = ri = cd = False

    def _update_rts_state(self):
        """Nothing to set."""

    _update_dtr_state = _update_break_state = _update_rts_state


class Bridge:
    """Serves a serial port over TCP on loopback to one client; bytes wait `latency_s` in each direction.

    It takes a free TCP port, or the one that is given by `at`.
    """

    def __init__(self, port: str, *, baud: int, latency_s: float, protocol: str, at: int = 0) -> None:
        self._serial = NoModemLines(port, baud, timeout=0)
        self._latency_s = latency_s
        self._protocol = protocol
        self._listener = socket.create_server(("127.0.0.1", at))
        self.at = self._listener.getsockname()[1]
        self._stop = threading.Event()
        self.clients = 0
        self._to_client: deque[tuple[float, bytes]] = deque()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """For the bench file."""
        return f"{self._protocol}://127.0.0.1:{self.at}"

    def write(self, data: bytes) -> None:
        """What the port manager answers by itself to the client."""
        self._to_client.append((time.monotonic() + self._latency_s, data))

    def _serve(self) -> None:
        while not self._stop.is_set():
            if not select.select([self._listener], [], [], 0.05)[0]:
                continue
            connection, _ = self._listener.accept()
            self.clients += 1
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    self._talk(connection)
                except OSError:
                    continue

    def _talk(self, connection: socket.socket) -> None:
        self._to_client.clear()
        to_port: deque[tuple[float, bytes]] = deque()
        manager = rfc2217.PortManager(self._serial, self) if self._protocol == "rfc2217" else None
        while not self._stop.is_set():
            waits = [q[0][0] - time.monotonic() for q in (self._to_client, to_port) if q]
            ready, _, _ = select.select(
                [connection, self._serial.fileno()], [], [], min(max(0.0, min(waits, default=0.02)), 0.02)
            )
            now_s = time.monotonic()
            if connection in ready:
                data = connection.recv(4096)
                if not data:
                    return
                plain = data if manager is None else b"".join(manager.filter(data))
                to_port.append((now_s + self._latency_s, plain))
            if self._serial.fileno() in ready:
                data = self._serial.read(4096)
                self.write(data if manager is None else b"".join(manager.escape(data)))
            while to_port and to_port[0][0] <= now_s:
                self._serial.write(to_port.popleft()[1])
            while self._to_client and self._to_client[0][0] <= now_s:
                connection.sendall(self._to_client.popleft()[1])

    def close(self) -> None:
        """Hang up."""
        self._stop.set()
        self._thread.join(5.0)
        self._listener.close()
        self._serial.close()


class SocketCanDaemon:
    """A `socketcand` server that passes frames of any python-can bus on to one client, later.

    Speaks the daemon's raw mode (github.com/linux-can/socketcand, doc/protocol.md).
    """

    def __init__(self, bus, *, latency_s: float, at: int = 0) -> None:
        self._bus, self._latency_s = bus, latency_s
        self._listener = socket.create_server(("127.0.0.1", at))
        self.port = self._listener.getsockname()[1]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._stop.is_set():
            if not select.select([self._listener], [], [], 0.05)[0]:
                continue
            connection, _ = self._listener.accept()
            with connection:
                connection.sendall(b"< hi >")
                for expected in (b"< open can0 >", b"< rawmode >"):
                    assert connection.recv(100) == expected
                    connection.sendall(b"< ok >")
                try:
                    self._send(connection)
                except OSError:
                    continue

    def _send(self, connection: socket.socket) -> None:
        waiting: deque[tuple[float, bytes]] = deque()
        while not self._stop.is_set():
            message = self._bus.recv(0.002)
            now_s = time.monotonic()
            if message is not None:
                data = message.data.hex().upper()
                text = f"< frame {message.arbitration_id:03X} {message.timestamp:.6f} {data} >"
                waiting.append((now_s + self._latency_s, text.encode()))
            while waiting and waiting[0][0] <= now_s:
                connection.sendall(waiting.popleft()[1])

    def close(self) -> None:
        """Hang up."""
        self._stop.set()
        self._thread.join(5.0)
        self._listener.close()
        self._bus.shutdown()
