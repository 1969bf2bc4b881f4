"""The monitor's own process: cycle records from standard input, Rerun behind it.

Frames on standard input come from `hil.monitor.sink` in the parent process and from nowhere else
(they are pickles). Ends with the end frame or when the parent is gone; an interrupt is the parent's.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Sequence
from typing import BinaryIO

from hil.monitor.sink import END, FRAME, PATH, READY, RECORD

_NICE = 10


def _frame(pipe: BinaryIO) -> tuple[bytes, int, bytes]:
    head = pipe.read(FRAME.size)
    if len(head) < FRAME.size:
        return END, 0, b""
    kind, length, dropped = FRAME.unpack(head)
    payload = pipe.read(length)
    return (kind, dropped, payload) if len(payload) == length else (END, 0, b"")


def main(targets: Sequence[str], pipe: BinaryIO) -> int:
    """Show records until the end frame."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    import rerun  # noqa: F401  # the slow part, before the parent is told to go on

    from hil.monitor.stream import RerunStream

    _, _, scene = _frame(pipe)
    if not scene:
        return 0
    os.write(sys.stdout.fileno(), READY)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    stream = RerunStream(tuple(targets), pickle.loads(scene))
    while True:
        kind, dropped, payload = _frame(pipe)
        if kind == PATH:
            stream.path(pickle.loads(payload))
        elif kind == RECORD:
            stream.add(pickle.loads(payload))
            stream.dropped(dropped)
        else:
            break
    stream.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], sys.stdin.buffer))
