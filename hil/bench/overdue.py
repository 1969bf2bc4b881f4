"""Calls into another package that do not come back: named while they run, and ended where that can be done.

A driver that waits for ever would stop the loop without a word. A thread looks at what is running. It says
what takes too long, and then interrupts the main thread by a signal, which reaches Python and system calls.
Foreign code that heeds neither cannot be ended from here: that is said, too. Servos hold a robot meanwhile:
their driver looks after them when nobody else does.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from hil.vocabulary.blame import PackageError

LOG = logging.getLogger(__name__)

_LOOK_S = 0.5
_TOLD, _ENDED = 4, 10
"""Looks at one call after which it is told of, and ended; while the process is stopped nobody looks."""
_COMPILER = "numba."
_SIGNAL = signal.SIGUSR2


class OverdueError(PackageError):
    """A call of a package's code did not come back, and was ended."""


class _Overdue(BaseException):
    """Ends a call; no `except Exception` of a package keeps it."""


@dataclass(eq=False)
class _Call:
    """What a thread is at."""

    kind: str
    package: str
    what: str
    began_s: float
    looks: int = 0

    def __str__(self) -> str:
        return f"{self.kind} ({self.package}): {self.what}"


_RUNNING: dict[int, _Call] = {}
"""By thread: the innermost call that runs."""
_WATCHMEN: list[threading.Thread] = []


@contextmanager
def not_for_ever(kind: str, package: str, what: str) -> Iterator[None]:
    """Run code of a package that is to come back soon.

    Args:
        kind: of the device.
        package: name and version.
        what: is run, for example `read()`.

    Raises:
        OverdueError: it has been ended.
    """
    _watch()
    ident = threading.get_ident()
    outer = _RUNNING.get(ident)
    call = _RUNNING[ident] = _Call(kind, package, what, time.monotonic())
    try:
        yield
    except _Overdue:
        ran_s = time.monotonic() - call.began_s
        raise OverdueError(
            kind, package, f"{what} had not come back after {ran_s:.1f} s and was ended",
            expected="a call that comes back without waiting for anything",
        ) from None  # fmt: skip
    finally:
        if outer is None:
            del _RUNNING[ident]
        else:
            _RUNNING[ident] = outer


def _watch() -> None:
    """Have a thread look, and the main thread listen to it."""
    if not (_WATCHMEN and _WATCHMEN[0].is_alive()):
        _WATCHMEN[:] = [threading.Thread(target=_look, name="overdue", daemon=True)]
        _WATCHMEN[0].start()
    if signal.getsignal(_SIGNAL) is not _end and threading.current_thread() is threading.main_thread():
        signal.signal(_SIGNAL, _end)


def _end(_number: int, _frame: FrameType | None) -> None:
    """In the main thread: leave the call that is overdue, if it still runs."""
    call = _RUNNING.get(threading.get_ident())
    if call is not None and call.looks >= _ENDED:
        raise _Overdue


def _look() -> None:
    while True:
        time.sleep(_LOOK_S)
        frames = sys._current_frames()
        for ident, call in list(_RUNNING.items()):
            if not _compiles(frames.get(ident)):
                call.looks += 1
                _judge(ident, call)


def _compiles(frame: FrameType | None) -> bool:
    """Whether a thread waits for our own code to be compiled, which takes a while at the first start."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False


def _judge(ident: int, call: _Call) -> None:
    ran_s = time.monotonic() - call.began_s
    if call.looks == _TOLD:
        LOG.warning("%s has been running for %.1f s", call, ran_s)
    if call.looks == 0 or call.looks % _ENDED:
        return
    heard = ident == threading.main_thread().ident and signal.getsignal(_SIGNAL) is _end
    if not heard or call.looks > _ENDED:
        LOG.error(
            "%s has been running for %.1f s and cannot be ended from here: end process %d (kill -9); servos "
            "with torque go on holding the robot", call, ran_s, os.getpid(),
        )  # fmt: skip
    if heard:
        signal.pthread_kill(ident, _SIGNAL)
