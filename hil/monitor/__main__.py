"""The monitor's own process: cycle records from standard input, Rerun behind it.

Messages on standard input (`hil.monitor.record_pipe`) come from `hil.monitor.sink` in the parent process and
from nowhere else (they are pickles). The process ends with the empty message or when the parent is gone, even
if Rerun then waits for a viewer without end; SIGINT is left to the parent. The exit code is 1 if an output
could not be opened or did not accept everything.
"""

import logging
import os
import pickle
import signal
import sys
import threading
from collections.abc import Sequence
from typing import BinaryIO

from hil.core.errors import reason_of
from hil.core.signals import CycleRecord
from hil.monitor.record_pipe import READY, taken

_NICE = 10
_LOOK_S, _LEFT_S = 1.0, 15.0
"""Poll interval for the parent, and time to finish once it is gone."""


def _outlive_not(parent: int) -> None:
    """Thread: end the process some time after its parent has ended, even if Rerun still waits."""
    nothing = threading.Event()
    while os.getppid() == parent:
        nothing.wait(_LOOK_S)
    nothing.wait(_LEFT_S)
    os._exit(1)


def main(targets: Sequence[str], pipe: BinaryIO) -> int:
    """Show the records from the pipe until its end; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s")
    threading.Thread(target=_outlive_not, args=(os.getppid(),), daemon=True).start()
    os.nice(_NICE)
    import rerun  # noqa: F401  # the slow part, before the parent continues

    from hil.monitor.rerun_stream import RerunStream

    scene, _ = taken(pipe)
    if not scene:
        return 0
    try:
        os.write(sys.stdout.fileno(), READY)
    except BrokenPipeError:
        return 0
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        stream = RerunStream(tuple(targets), pickle.loads(scene))
    except (RuntimeError, ValueError, OSError) as error:
        print(f"hil monitor: {', '.join(targets)} cannot be opened ({reason_of(error)})", file=sys.stderr)
        os._exit(1)
    while True:
        payload, dropped = taken(pipe)
        if not payload:
            break
        for shown in pickle.loads(payload):
            if isinstance(shown, CycleRecord):
                stream.add(shown)
            else:
                stream.path(shown)
        stream.dropped(dropped)
    if not stream.close():
        os._exit(1)  # Rerun would wait for the viewer once more
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], sys.stdin.buffer))
