"""Signals during a run: finish the step, or stop now.

SIGINT once asks for an orderly end at the next step; SIGINT again, SIGTERM or SIGHUP ends the work at
once: `Aborted` is raised in the main thread, on whose way out the robot is stopped. It is raised once: that
way out is not cut short. Inside `deferred()` (writing a record, opening and closing a bench, tearing down,
all that comes after the verdict) a signal waits for the end of the block, or for the code
of a device package in it that has been running for too long: it may never come back.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

from hil.bench.overdue import leave
from hil.vocabulary.errors import Aborted, StepTimeoutError
from hil.vocabulary.stop_signals import handled_by

_TWICE = "a second SIGINT"
_BY = {
    "SIGINT": "Ctrl-C or “Finish the step, then end” (SIGINT)",
    _TWICE: "Ctrl-C twice (a second SIGINT)",
    "SIGTERM": "STOP or whoever else asked it to end (SIGTERM)",
    "SIGHUP": "its terminal, which was closed (SIGHUP)",
}
"""Who sends a signal, for people who did not send it by that name."""


class Interrupts:
    """State of the signals of one run.

    Args:
        tell: called with a line for the operator.
    """

    def __init__(self, tell: Callable[[str], None] = lambda text: None) -> None:
        self._tell = tell
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
                self._tell("finishing the step; press Ctrl-C again to stop now")
                return
            name = _TWICE
        self._stop = self._stop or name
        if self._raised:
            return
        if not self._deferred:
            self.stop_here()
        else:
            leave(self._left)

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

    def installed(self) -> AbstractContextManager[None]:
        """Handle the signals of this process; only possible in the main thread, elsewhere nothing."""
        return handled_by(self.handle)


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
