"""Writes the daemon's log in a thread, so that a disk that is slow, full or gone delays no command."""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading
import time
from pathlib import Path

_MOST_BYTES = 1 << 20
_MOST_WAITING = 1000


class Log:
    """Lines with their time of day; what cannot be written is lost.

    Args:
        path: the file, appended to and begun anew when it is long, readable by its owner; stderr when None.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def say(self, text: str) -> None:
        """Take a line. Never blocks nor raises, not in a signal handler either."""
        if self._lines.qsize() < _MOST_WAITING:
            self._lines.put(f"{time.strftime('%Y-%m-%d %H:%M:%S%z')} {text}\n")

    def close(self) -> None:
        """Write what waits, for a second at most."""
        self._lines.put(None)
        self._thread.join(1.0)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError, ValueError):
                if self.path is None:
                    sys.stderr.write(line)
                    sys.stderr.flush()
                else:
                    _append(self.path, line)


def _append(path: Path, line: str) -> None:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if path.exists() and path.stat().st_size > _MOST_BYTES:
        path.replace(path.with_suffix(".log.1"))
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "a", encoding="utf-8") as file:
        file.write(line)
