"""Programs that have the client side of an emulated serial port open.

The kernel reports by inotify that the terminal was opened or closed, and merges equal reports. So a report
that it was closed is followed by a look at which programs still have it open: in a thread, as it takes 10 ms.
"""

from __future__ import annotations

import ctypes
import os
import struct
import threading
from collections.abc import Callable

from hil.support.port_users import own_descriptors_of, programs_with

_CLOSED, _OPENED = 0x08 | 0x10, 0x20
_EVENT = struct.Struct("iIII")
_MOST_BYTES = 4096


class PtyClients:
    """The programs at one terminal; without inotify one is taken to be there always.

    Args:
        path: path of the terminal, which this process has open once.
        on_left: called when the last program has closed it, also by being killed.
    """

    def __init__(self, path: str, on_left: Callable[[], None]) -> None:
        self._path, self._on_left = path, on_left
        self._look: _Look | None = None
        libc = ctypes.CDLL(None, use_errno=True)
        self._fd: int = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd >= 0 and libc.inotify_add_watch(self._fd, path.encode(), _OPENED | _CLOSED) < 0:
            self.close()
        self._present: bool = self._fd < 0
        self._openings = 0

    def filenos(self) -> list[int]:
        """Descriptor that is readable when a program has come or gone, if the system has such."""
        return [self._fd] if self._fd >= 0 else []

    def came(self) -> None:
        """A program has sent something, so it is there."""
        self._present, self._openings = True, self._openings + 1

    def present(self) -> bool:
        """Whether any program has the terminal open."""
        self._read_events()
        look = self._look
        if look is not None and not look.is_alive():
            self._look = None
            if not look.found and look.openings == self._openings:
                self._present = False
                self._on_left()
        return self._present

    def close(self) -> None:
        """Stop watching, and wait for a look that has begun. Idempotent."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)
        look, self._look = self._look, None
        if look is not None:
            look.join()

    def _read_events(self) -> None:
        try:
            data = os.read(self._fd, _MOST_BYTES) if self._fd >= 0 else b""
        except BlockingIOError:
            return
        for _, mask, _, _ in _EVENT.iter_unpack(data):
            if mask & _OPENED:
                self.came()
            elif mask & _CLOSED:
                self._look = _Look(self._path, self._openings, self._look)


class _Look(threading.Thread):
    """Finds out whether other programs, or this one a second time, have a terminal open.

    A look ends after the one before it.

    Attributes:
        found: the answer, once the thread has ended.
        openings: number of times that it had been opened when the look began.
    """

    def __init__(self, path: str, openings: int, before: _Look | None) -> None:
        super().__init__(name="clients of a terminal", daemon=True)
        self._path, self.openings, self.found, self._before = path, openings, True, before
        self.start()

    def run(self) -> None:
        """Look."""
        if self._before is not None:
            self._before.join()
            self._before = None
        self.found = own_descriptors_of(self._path) > 1 or bool(programs_with(self._path))
