"""Handles signals during a run: finish the step, or stop now; and then leave out drawing the figures.

The first SIGINT requests an orderly end after the current step, which may take `patience_s`. A second
SIGINT, SIGTERM, SIGHUP or a step that takes longer stops the work at once: `Aborted` is raised in the main
thread, and the robot is stopped. It is raised once, so that stopping is not interrupted. Inside `deferred()`
(exchanges with devices, writing a record, opening and closing a bench, teardown, everything after the
verdict) a signal waits for the end of the block. It does not wait for code of a device package that has been
running for too long, because this may never return.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from hil.bench.third_party.call_timeout import leave
from hil.core.errors import Aborted, StepTimeoutError
from hil.support.interrupt_signals import handled_by

PATIENCE_S = 1.0
"""Time allowed for the step to end after Ctrl-C, s."""
_TWICE = "a second SIGINT"
_LATE = "SIGINT, and time"
_BY = {
    "SIGINT": "Ctrl-C or “Finish the step, then end” (SIGINT)",
    _LATE: "Ctrl-C (SIGINT): the step did not end in time",
    _TWICE: "Ctrl-C twice (a second SIGINT)",
    "SIGTERM": "STOP or another program (SIGTERM)",
    "SIGHUP": "its terminal, which was closed (SIGHUP)",
}
"""The source of a signal, in words."""


class _LeftOut(BaseException):
    """Ends work that a user does not want to wait for; not caught by code that handles errors."""


class Interrupts:
    """State of the signals of one run.

    Args:
        tell: called with a line for the operator.
        patience_s: time for which a step may continue after the first SIGINT, s of the computer's clock; None
            for no limit.
    """

    def __init__(
        self, tell: Callable[[str], None] = lambda text: None, patience_s: float | None = None
    ) -> None:
        self._tell, self._patience_s = tell, patience_s
        self._timer: threading.Timer | None = None
        self._late = False
        self._installed = 0
        self._sigints = 0
        self._stop: str | None = None
        self._deferred = 0
        self._raised = False
        self._can_be_left_out = False

    @property
    def asked_to_finish(self) -> bool:
        """Whether the run should end after the current step."""
        return self._sigints > 0 or self._stop is not None

    def finish_here(self, where: str = "between two steps", remedy: str = "") -> None:
        """Raise `Aborted` at a boundary between steps if a stop was requested.

        Args:
            where: the boundary, as text.
            remedy: action that the user can take then.
        """
        if self.asked_to_finish:
            raise Aborted(f"ended by {_BY[self._stop or 'SIGINT']} {where}", remedy=remedy)

    def stopping(self) -> Aborted | None:
        """Return `Aborted` if an immediate stop was requested, else None; later signals raise nothing."""
        if self._stop is None:
            return None
        self._raised = True
        return Aborted(f"stopped at once by {_BY[self._stop]}")

    def stop_here(self) -> None:
        """Within a step: raise `Aborted` if an immediate stop was requested."""
        stopping = self.stopping()
        if stopping is not None:
            raise stopping

    def handle(self, number: int, _frame: FrameType | None = None) -> None:
        """Handle a signal: request a stop, or raise `Aborted`."""
        if self._can_be_left_out:
            self._can_be_left_out = False
            raise _LeftOut
        name = signal.Signals(number).name
        if number == signal.SIGINT:
            self._sigints += 1
            if self._sigints == 1:
                self._give_time()
                return
            name = _LATE if self._late else _TWICE
        self._stop = self._stop or name
        if self._raised:
            return
        if not self._deferred:
            self.stop_here()
        else:
            leave(self._left)

    def _give_time(self) -> None:
        """Let the step continue for `patience_s`; then send SIGINT to the main thread."""
        if self._patience_s is None:
            self._tell("finishing the step; press Ctrl-C again to stop now")
            return
        self._tell(f"finishing the step, for at most {self._patience_s:g} s; press Ctrl-C again to stop now")
        self._timer = threading.Timer(self._patience_s, self._no_more_time, [threading.main_thread().ident])
        self._timer.daemon = True
        self._timer.start()

    def _no_more_time(self, thread: int) -> None:
        self._late = True
        signal.pthread_kill(thread, signal.SIGINT)

    def _left(self, running: str) -> Aborted:
        """Return the error for a call that is abandoned, because it ran too long after a stop request."""
        self._raised = True
        return Aborted(f"stopped by {_BY[self._stop or _TWICE]} while this was running: {running}")

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Defer a stop to the end of the block."""
        self._deferred += 1
        try:
            yield
        finally:
            self._deferred -= 1

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Within a deferred block, allow a stop at once."""
        deferred, self._deferred = self._deferred, 0
        try:
            self.stop_here()
            yield
        finally:
            self._deferred = deferred

    @contextmanager
    def left_out_on_request(self, what: str) -> Iterator[None]:
        """After a signal has ended the run: say what is done now, and leave it out at a further signal.

        Args:
            what: the work, without which the results are complete.
        """
        if not self.asked_to_finish:
            yield
            return
        self._end_timer()
        self._tell(f"{what}; press Ctrl-C again to leave that out")
        try:
            self._can_be_left_out = True
            yield
        except _LeftOut:
            self._tell(f"{what}: left out")
        finally:
            self._can_be_left_out = False

    def _end_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()  # a signal that it has sent is still handled here

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Handle the signals of this process; does nothing outside of the main thread."""
        with handled_by(self.handle):
            self._installed += 1
            try:
                yield
            finally:
                self._installed -= 1
                if not self._installed:
                    self._end_timer()


@contextmanager
def time_limit(limit_s: float, what: str) -> Iterator[None]:
    """Raise `StepTimeoutError` if a block takes longer than `limit_s`, by a timer of the operating system.

    For work that hangs without running the loop; only in the main thread. A timer that was already running,
    for example of pytest-timeout, continues afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def expired(_number: int, _frame: FrameType | None) -> None:
        raise StepTimeoutError(what, limit_s)

    before = signal.signal(signal.SIGALRM, expired)
    others_s, interval_s = signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        used_s = limit_s - signal.getitimer(signal.ITIMER_REAL)[0]
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if others_s:
            signal.setitimer(signal.ITIMER_REAL, max(others_s - used_s, 1e-3), interval_s)
