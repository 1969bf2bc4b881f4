"""A serial line on a pseudo-terminal: any client opens it as it would open a USB adapter.

The kernel shows the rate that the client has set, so a wrong baud rate is heard as noise. A PTY has
no modem lines and cannot be pulled out: during `unplug` it is silent.
"""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
import tty

from hil.fakes.serial_line import SerialLine, Unplugged
from hil.fakes.server import Transport

_TCGETS2 = 0x802C542A
_TERMIOS2_WORDS, _OSPEED_WORD = 11, 10
_CHUNK = 4096


class SerialPty(Transport):
    """The client side of a line as a terminal device.

    Args:
        line: the emulated line; also a part of the world of its own.
        nominal: values for clients beside the port (`baud`, `ids`, ...).
    """

    def __init__(self, line: SerialLine, nominal: dict[str, object] | None = None) -> None:
        self._line, self._nominal = line, dict(nominal or {})
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._open = True
        self.lost = 0
        line.listen(self._baud)

    def next_due_ns(self) -> int:
        """When the next bytes reach the host."""
        return self._line.next_arrival_ns()

    def on_due(self, t_ns: int) -> None:
        """Hand arrived bytes to the terminal; those far too late, or never read, are lost and counted."""
        data = self._line.take(_CHUNK)
        if not self._open:
            return
        written = 0
        if not self.behind:
            with contextlib.suppress(BlockingIOError):
                written = os.write(self._master, data)
        self.lost += len(data) - written

    def filenos(self) -> list[int]:
        """The emulator's end of the terminal."""
        return [self._master] if self._open else []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Take the client's bytes at the rate that it has set."""
        try:
            data = os.read(fd, _CHUNK)
        except OSError:
            return
        with contextlib.suppress(Unplugged):
            self._line.send(data, self._baud())

    def endpoint(self) -> dict[str, object]:
        """Device path, and what the client should know."""
        return {"port": os.ttyname(self._slave) if self._open else "", **self._nominal}

    def close(self) -> None:
        """Close both ends. Idempotent."""
        if self._open:
            self._open = False
            self._line.listen(None)
            os.close(self._master)
            os.close(self._slave)

    def _baud(self) -> int:
        """The rate set on the client's side; arbitrary rates need termios2 (Linux)."""
        words = array.array("I", [0] * _TERMIOS2_WORDS)
        fcntl.ioctl(self._slave, _TCGETS2, words, True)
        return words[_OSPEED_WORD] or 1
