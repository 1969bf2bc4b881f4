"""Time limits for calls into another package: reports calls that do not return, and ends them if possible.

A driver that blocks for ever would stop the loop silently. A watchdog thread observes the running call. It
logs a warning when the call takes too long, and then interrupts the main thread by a signal, which ends
Python code and system calls. Foreign code that reacts to neither cannot be ended from here: that is reported,
too. Servos hold a robot meanwhile: their driver keeps polling them when no other code does.

Opening a device may take seconds, so it has its own limits; a user who has requested the end of a run need
not wait for all of them (`leave`).
"""

import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType

from hil.core.errors import HilError
from hil.core.third_party_errors import PackageError

LOG = logging.getLogger(__name__)

_LOOKS_PER_S = 2
_LOOK_S = 1.0 / _LOOKS_PER_S
_COMPILER = "numba."
_SIGNAL = signal.SIGUSR2


@dataclass(frozen=True)
class TimeLimit:
    """Time limit of a call, counted in polls of the watchdog thread; a stopped process does not count.

    Attributes:
        reported: polls after which a warning is logged.
        ended: polls after which the call is ended.
        expected: text on the expected behaviour of the call.
        may_be_left: True if `leave` ends the call once the warning is logged.
    """

    reported: int
    ended: int
    expected: str
    may_be_left: bool = False


IN_A_CYCLE = TimeLimit(
    2 * _LOOKS_PER_S, 5 * _LOOKS_PER_S, "a call that comes back without waiting for anything"
)
BESIDE_CYCLES = TimeLimit(2 * _LOOKS_PER_S, 10 * _LOOKS_PER_S, "a call that comes back soon")
AT_THE_END = replace(BESIDE_CYCLES, may_be_left=True)
_OPENING_S = 30.0
_BEYOND_TIMEOUTS_S = 5.0


def opening(timeouts_s: float = 0.0) -> TimeLimit:
    """Limit for opening a device: 30 s, or 5 s more than the timeouts in its table if that is longer."""
    ended_s = max(_OPENING_S, timeouts_s + _BEYOND_TIMEOUTS_S)
    return TimeLimit(
        5 * _LOOKS_PER_S,
        math.ceil(ended_s * _LOOKS_PER_S),
        f"a call that gives up after less than {ended_s:g} s and raises DeviceError",
        True,
    )


class CallTimeoutError(PackageError):
    """A call of a package's code did not return in time, and was ended."""


class _Overdue(BaseException):
    """Ends a call; `except Exception` in a package does not catch it."""


@dataclass(eq=False)
class _Call:
    """A running call of a thread."""

    kind: str
    package: str
    what: str
    limit: TimeLimit
    began_s: float
    looks: int = 0
    asked: Callable[[str], HilError] | None = None

    @property
    def most(self) -> int:
        """Polls after which the call is ended."""
        return self.limit.ended if self.asked is None else self.limit.reported

    def __str__(self) -> str:
        return f"{self.kind} ({self.package}): {self.what}"


_RUNNING: dict[int, _Call] = {}
"""The innermost running call, by thread."""
_WATCHMEN: list[threading.Thread] = []


@contextmanager
def with_time_limit(kind: str, package: str, what: str, limit: TimeLimit = IN_A_CYCLE) -> Iterator[None]:
    """Run code of a package under a time limit.

    Args:
        kind: the device's kind.
        package: name and version.
        what: the code that runs, for example `read()`.
        limit: time limit of the call.

    Raises:
        CallTimeoutError: the call was ended at the limit.
        HilError: the call was ended by `leave`, which supplies the error.
    """
    _watch()
    ident = threading.get_ident()
    outer = _RUNNING.get(ident)
    call = _Call(kind, package, what, limit, time.monotonic())
    try:
        _RUNNING[ident] = call
        yield
    except _Overdue:
        if call.asked is not None:
            raise call.asked(str(call)) from None
        ran_s = time.monotonic() - call.began_s
        raise CallTimeoutError(
            kind,
            package,
            f"{what} had not come back after {ran_s:.1f} s and was ended",
            expected=limit.expected,
        ) from None
    finally:
        if outer is None:
            _RUNNING.pop(ident, None)
        else:
            _RUNNING[ident] = outer


def leave(error: Callable[[str], HilError]) -> None:
    """End the running call if `may_be_left`, once its warning is logged; for a signal handler.

    Until then it may return by itself, so that a healthy device finishes opening before it is closed.

    Args:
        error: function that makes the error that the call raises, from a description of the call.
    """
    call = _RUNNING.get(threading.get_ident())
    if call is not None and call.limit.may_be_left:
        call.asked = error
        _end()


def _watch() -> None:
    """Start the watchdog thread and, in the main thread, install the signal handler."""
    if not (_WATCHMEN and _WATCHMEN[0].is_alive()):
        _WATCHMEN[:] = [threading.Thread(target=_look, name="overdue", daemon=True)]
        _WATCHMEN[0].start()
    if signal.getsignal(_SIGNAL) is not _end and threading.current_thread() is threading.main_thread():
        signal.signal(_SIGNAL, _end)


def _end(_number: int = _SIGNAL, _frame: FrameType | None = None) -> None:
    """Signal handler of the main thread: raise `_Overdue` if the running call has exceeded its limit."""
    call = _RUNNING.get(threading.get_ident())
    if call is not None and call.looks >= call.most:
        raise _Overdue


def _look() -> None:
    while True:
        time.sleep(_LOOK_S)
        for ident, call in list(_RUNNING.items()):
            if not _compiles(sys._current_frames().get(ident)):  # a kept frame keeps its objects
                call.looks += 1
                _judge(ident, call)


def _compiles(frame: FrameType | None) -> bool:
    """Whether a thread compiles code of this package, which takes a while at the first start."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False


def _judge(ident: int, call: _Call) -> None:
    ran_s = time.monotonic() - call.began_s
    if call.looks == call.limit.reported:
        LOG.warning("%s has been running for %.1f s", call, ran_s)
    if call.looks == 0 or call.looks % call.most:
        return
    heard = ident == threading.main_thread().ident and signal.getsignal(_SIGNAL) is _end
    if not heard or call.looks > call.most:
        LOG.error(
            "%s has been running for %.1f s and cannot be ended from here: end process %d (kill -9); servos "
            "with torque go on holding the robot",
            call,
            ran_s,
            os.getpid(),
        )
    if heard:
        signal.pthread_kill(ident, _SIGNAL)
