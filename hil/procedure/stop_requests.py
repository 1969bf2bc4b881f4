"""Signals during a run: finish the step, or stop now.

SIGINT once asks for an orderly end at the next step, for which the step has `patience_s`. SIGINT again,
SIGTERM or SIGHUP, or a step that takes longer, ends the work at once: `Aborted` is raised in the main thread,
on whose way out the robot is stopped. It is raised once: that way out is not cut short. Inside `deferred()`
(writing a record, opening and closing a bench, tearing down, all that comes after the verdict) a signal waits
for the end of the block, or for the code of a device package in it that has been running for too long: it may
never come back.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from hil.bench.third_party.call_timeout import leave
from hil.core.errors import Aborted, StepTimeoutError
from hil.support.stop_signals import handled_by

PATIENCE_S = 1.0
"""For how long a person who has pressed Ctrl-C waits for the end of the step."""
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


class Interrupts:
    """State of the signals of one run.

    Args:
        tell: called with a line for the operator.
        patience_s: how long a step may go on after the first SIGINT, s of the computer's clock; None for as
            long as it takes.
    """

    def __init__(
        self, tell: Callable[[str], None] = lambda text: None, patience_s: float | None = None
    ) -> None:
        self._tell, self._patience_s = tell, patience_s
        self._timer: threading.Timer | None = None
        self._late = False
        self._installed = 0
        self._asked = 0
        self._stop: str | None = None
        self._deferred = 0
        self._raised = False

    @property
    def asked_to_finish(self) -> bool:
        """Whether the run should end after the current step."""
        return self._asked > 0 or self._stop is not None

    def finish_here(self, where: str = "between two steps", remedy: str = "") -> None:
        """At a boundary between steps: raise `Aborted` if that was asked for.

        Args:
            where: that boundary, in words.
            remedy: what to do then.
        """
        if self.asked_to_finish:
            raise Aborted(f"ended by {_BY[self._stop or 'SIGINT']} {where}", remedy=remedy)

    def stopping(self) -> Aborted | None:
        """What to end a step with where an immediate stop was asked for; signals raise nothing any more."""
        if self._stop is None:
            return None
        self._raised = True
        return Aborted(f"stopped at once by {_BY[self._stop]}")

    def stop_here(self) -> None:
        """Within a step: raise `Aborted` if an immediate stop was asked for."""
        stopping = self.stopping()
        if stopping is not None:
            raise stopping

    def handle(self, number: int, _frame: FrameType | None = None) -> None:
        """Take a signal."""
        name = signal.Signals(number).name
        if number == signal.SIGINT:
            self._asked += 1
            if self._asked == 1:
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
        """Let the step go on for a while; then this process gets the signal without waiting."""
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
        """What a call is left with that had been running for too long when a stop was asked for."""
        self._raised = True
        return Aborted(f"stopped by {_BY[self._stop or _TWICE]} while this was running: {running}")

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Let a whole piece of work happen before a stop is taken."""
        self._deferred += 1
        try:
            yield
        finally:
            self._deferred -= 1

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """Within a deferred whole, the piece of work that a stop may end at once."""
        deferred, self._deferred = self._deferred, 0
        try:
            self.stop_here()
            yield
        finally:
            self._deferred = deferred

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Handle the signals of this process; only possible in the main thread, elsewhere nothing."""
        with handled_by(self.handle):
            self._installed += 1
            try:
                yield
            finally:
                self._installed -= 1
                if not self._installed and self._timer is not None:
                    self._timer.cancel()
                    self._timer.join()  # its signal, if it was sent, is still taken here


@contextmanager
def time_limit(limit_s: float, what: str) -> Iterator[None]:
    """Raise `StepTimeoutError` in a block that takes longer than the operating system's timer allows.

    The last resort for work that hangs without running the loop; only in the main thread. A timer that
    was running (of pytest-timeout, say) runs on afterwards.
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
