"""Polls the servos while no loop runs (after a stop, between motions), so that their watchdog stays fed.

A robot on a wall hangs by the torque of its servos. A servo that restarts has no torque and does not report
that; a program that has stopped its loop would not read it. So from `enable` until `release` or `close` the
servos are always polled: by the loop in its cycles, and in between by `KeepAlive`.
"""

import logging
import threading
from collections.abc import Callable

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import HilError

_LOG = logging.getLogger(__name__)

_LONGEST_ALONE_S = 0.1
_SHARE = 0.8
"""Share of the watchdog's time after which the servos are polled."""
_CALM_NS, _ALERT_NS = nanoseconds(0.05), nanoseconds(0.02)


class KeepAlive:
    """Polls the servos when nothing else has talked to them for a while.

    Args:
        clock: the bench clock.
        lock: lock that is held while the servos are talked to, not re-entrant; this never waits for it.
        visit: function that polls once, called with the lock held; returns whether all is well.
        watchdog_s: time of the servos' watchdog; 0 without one.
    """

    def __init__(
        self, clock: Clock, lock: threading.Lock, visit: Callable[[], bool], *, watchdog_s: float
    ) -> None:
        self._clock, self._lock, self._visit = clock, lock, visit
        longest_s = min(watchdog_s or _LONGEST_ALONE_S, _LONGEST_ALONE_S)
        self._alone_ns = nanoseconds(_SHARE * longest_s)
        self._end: Callable[[], None] | None = None
        self._attended_ns = 0

    def attended(self, now_ns: int) -> None:
        """Note that the loop has just talked to the servos."""
        self._attended_ns = now_ns

    def begin(self) -> None:
        """Start polling. Idempotent."""
        if self._end is None:
            self._attended_ns = self._clock.now_ns()
            self._end = self._clock.schedule(self._look_in, self._attended_ns + self._alone_ns)

    def end(self) -> None:
        """Stop polling. Idempotent."""
        if self._end is not None:
            self._end()
            self._end = None

    def _look_in(self, now_ns: int) -> int:
        due_ns = self._attended_ns + self._alone_ns
        if now_ns < due_ns:
            return due_ns
        if not self._lock.acquire(blocking=False):
            return now_ns + _ALERT_NS
        try:
            well = self._visit()
        except Exception as error:  # whatever fails: the next visit may hold the robot
            named = "" if isinstance(error, HilError) else f"{type(error).__name__}: "
            _LOG.warning("while no loop talked to the servos: %s%s", named, error)
            well = False
        finally:
            self._lock.release()
        return self._clock.now_ns() + (_CALM_NS if well else _ALERT_NS)
