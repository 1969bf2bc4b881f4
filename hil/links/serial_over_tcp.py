"""Serial ports of another computer: raw TCP (`socket://`) and RFC 2217 servers (`rfc2217://`).

pyserial's network ports are made for terminals. `socket://` says 1 for any number of bytes that wait and
holds small packets back until the last one is acknowledged. A read of `rfc2217://` that does not wait gives
one byte, and each change of a timeout negotiates with the server for 50 ms. These ports say how many bytes
wait and give them all, negotiate only when a line setting changes, and notice a server that has vanished.
"""

import array
import contextlib
import fcntl
import queue
import socket
import termios
import warnings
from typing import Any

import serial
from serial import rfc2217
from serial.urlhandler import protocol_socket

RFC2217, SOCKET = "rfc2217://", "socket://"
_Rfc2217: Any = rfc2217.Serial  # the attributes that are needed here are no part of its type
_Raw: Any = protocol_socket.Serial
_ALIVE = (
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 2),
    (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 3000),
)
"""Small packets leave at once; a server that lost its power or its cable is an error after 3 s."""


def open_network_port(url: str, *, baud: int, timeout_s: float, write_timeout_s: float) -> Any:
    """Open `socket://HOST:PORT` or `rfc2217://HOST:PORT`; raises as pyserial does.

    Args:
        url: URL of the port; its scheme in any case.
        baud: bits per second; a raw socket's server must be set to it.
        timeout_s: timeout of reads.
        write_timeout_s: timeout of writes to a raw socket.
    """
    if url.lower().startswith(SOCKET):
        return SocketPort(url, baudrate=baud, timeout=timeout_s, write_timeout=write_timeout_s)
    remote = RemotePort()
    remote.port, remote.baudrate, remote.timeout = url, baud, timeout_s
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pyserial 3.5 starts its thread the old way
        remote.open()
    return remote


def _keep_alive(connection: socket.socket) -> None:
    for level, option, value in _ALIVE:
        connection.setsockopt(level, option, value)


class SocketPort(_Raw):  # type: ignore[misc]
    """A raw TCP port."""

    _socket: Any = None

    def open(self) -> None:
        """Connect; raises `SerialException`."""
        super().open()
        _keep_alive(self._socket)

    @property
    def in_waiting(self) -> int:
        """How many bytes a read would give at once; 1 where it would raise, as the connection is closed."""
        closed: int = super().in_waiting
        if not closed:
            return 0
        count = array.array("i", [0])
        fcntl.ioctl(self._socket, termios.FIONREAD, count)
        return count[0] or closed

    def close(self) -> None:
        """Close it, also after a lost connection, where pyserial keeps the socket. Idempotent."""
        connection = self._socket
        super().close()
        if connection is not None:
            connection.close()


class RemotePort(_Rfc2217):  # type: ignore[misc]
    """An RFC 2217 port that is quick enough for a request and its reply."""

    _negotiated: tuple[object, ...] | None = None

    def open(self) -> None:
        """Connect and negotiate; raises `SerialException`."""
        super().open()
        _keep_alive(self._socket)

    @property
    def in_waiting(self) -> int:
        """How many bytes wait; raises `SerialException` once the connection is lost and all are read."""
        count: int = super().in_waiting
        if not count:
            self._check_connection()
        return count

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes: all that wait, or as many as come within the timeout."""
        if not self.is_open:
            raise serial.PortNotOpenError
        data = bytearray()
        with contextlib.suppress(queue.Empty):
            while len(data) < size and (byte := self._read_buffer.get(False)) is not None:
                data += byte
        if data and (len(data) == size or self._timeout == 0.0):
            return bytes(data)
        if not data:
            self._check_connection()
        rest: bytes = super().read(size - len(data)) if self._thread.is_alive() else b""
        return bytes(data) + rest

    def close(self) -> None:
        """Close it as `SocketPort.close` does. Idempotent."""
        connection = self._socket
        super().close()
        if connection is not None:
            connection.close()

    def _check_connection(self) -> None:
        if self._thread is None or not self._thread.is_alive():
            raise serial.SerialException("the connection is lost")

    def _reconfigure_port(self) -> None:
        wanted = (
            self._baudrate,
            self._bytesize,
            self._parity,
            self._stopbits,
            self._rtscts,
            self._dsrdtr,
            self._xonxoff,
        )
        if wanted != self._negotiated:
            super()._reconfigure_port()
            self._negotiated = wanted

    def reset_input_buffer(self) -> None:
        """Discard bytes that have arrived; those still under way are left to checksums."""
        if not self.is_open:
            raise serial.PortNotOpenError
        if self._read_buffer is not None:
            with contextlib.suppress(queue.Empty):
                while self._read_buffer.qsize():
                    self._read_buffer.get(False)
