"""When a look at a stopped robot is over: later for servos that fail in it, and for the doubt of a moment."""

from __future__ import annotations

from hil.bench.hold.motion_since_stop import WINDOW_NS
from hil.core.clock import nanoseconds
from hil.core.signals import ServoHold

_LATE_LOOKS = 25
"""So many looks, when time is up, a doubt may come and go."""
_LOSSES = 3
"""So often servos that fail during a look are waited for anew."""


class LookTime:
    """The time of one look.

    Args:
        began_ns: when it began.
        limit_s: so long, from there and from each failure of servos.
        strict: no longer in any case.
    """

    def __init__(self, began_ns: int, limit_s: float, *, strict: bool) -> None:
        self._limit_ns, self._strict = nanoseconds(limit_s), strict
        self._end_ns = began_ns + self._limit_ns
        self._answered, self._losses, self._late_looks = False, 0, 0
        self._clear_ns = self._waited_ns = -WINDOW_NS
        self._waits = self._momentary = False

    def heard(self, hold: ServoHold) -> None:
        """Take what the servos say: those that fail now are given as long again to come back."""
        if hold.trouble and self._answered and self._losses < _LOSSES and not self._strict:
            self._end_ns, self._losses = max(self._end_ns, hold.t_ns + self._limit_ns), self._losses + 1
        self._answered = not hold.trouble

    def saw(self, t_ns: int, *, doubt: bool, waits: bool) -> None:
        """Take what was seen of the robot.

        Args:
            t_ns: when.
            doubt: whether servos or motion speak against HELD.
            waits: whether propellers that are left alone are all that is still in doubt of the force.
        """
        self._waits = waits
        if waits:
            self._waited_ns = t_ns
        if not doubt:
            self._clear_ns = t_ns
        since_ns = max(self._clear_ns, self._waited_ns) if doubt else self._waited_ns
        self._momentary = t_ns - since_ns < WINDOW_NS

    def is_up(self, now_ns: int) -> bool:
        """Whether the look ends without the robot being held; asked once after each `saw`."""
        if now_ns < self._end_ns:
            return False
        self._late_looks += not self._waits
        return self._strict or not self._momentary or self._late_looks > _LATE_LOOKS
