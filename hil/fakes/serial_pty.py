"""A serial line on a pseudo-terminal: any client opens it as it would open a USB adapter.

The kernel gives the baud rate that the client has set, so that a wrong rate results in noise. A PTY has no
modem lines and cannot be unplugged: during `unplug` it is silent. Like the driver of an adapter it discards
what arrives while no client has it open, and forgets a client's claim to be the only one (TIOCEXCL) with it.
"""

import array
import contextlib
import fcntl
import os
import termios
import tty

from hil.fakes.pty_clients import PtyClients
from hil.fakes.serial_line import SerialLine, Unplugged
from hil.fakes.server import Transport

_TCGETS2 = 0x802C542A
_TERMIOS2_WORDS, _OSPEED_WORD = 11, 10
_CHUNK = 4096


class SerialPty(Transport):
    """Client side of a line as a terminal device.

    Args:
        line: the emulated line; it is also a separate part of the world.
        nominal: values for clients in addition to the port (`baud`, `ids`, ...).
    """

    def __init__(self, line: SerialLine, nominal: dict[str, object] | None = None) -> None:
        self._line, self._nominal = line, dict(nominal or {})
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._clients = PtyClients(os.ttyname(self._slave), self._forget_client)
        self._open = True
        self.lost = 0
        line.listen(self._baud)

    def next_due_ns(self) -> int:
        """Time at which the next bytes reach the host."""
        return self._line.next_arrival_ns()

    def on_due(self, t_ns: int) -> None:
        """Write received bytes to the terminal; count those that are far too late or not read in `lost`."""
        data = self._line.take(_CHUNK)
        if not self._open or not self._clients.present():
            return
        written = 0
        if not self.behind:
            with contextlib.suppress(BlockingIOError):
                written = os.write(self._master, data)
        self.lost += len(data) - written

    def filenos(self) -> list[int]:
        """File descriptors of the emulator's end of the terminal, and of its clients' coming and going."""
        return [self._master, *self._clients.filenos()] if self._open else []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Pass the client's bytes on at the baud rate that it has set."""
        if fd != self._master:
            self._clients.present()
            return
        try:
            data = os.read(fd, _CHUNK)
        except OSError:
            return
        self._clients.came()
        with contextlib.suppress(Unplugged):
            self._line.send(data, self._baud())

    def endpoint(self) -> dict[str, object]:
        """Device path, and further values for the client."""
        return {"port": os.ttyname(self._slave) if self._open else "", **self._nominal}

    def close(self) -> None:
        """Close both ends. Idempotent."""
        if self._open:
            self._open = False
            self._line.listen(None)
            self._clients.close()
            os.close(self._master)
            os.close(self._slave)

    def _forget_client(self) -> None:
        fcntl.ioctl(self._slave, termios.TIOCNXCL)
        termios.tcflush(self._slave, termios.TCIFLUSH)

    def _baud(self) -> int:
        """Baud rate set on the client's side; arbitrary rates need termios2 (Linux)."""
        words = array.array("I", [0] * _TERMIOS2_WORDS)
        fcntl.ioctl(self._slave, _TCGETS2, words, True)
        return words[_OSPEED_WORD] or 1
