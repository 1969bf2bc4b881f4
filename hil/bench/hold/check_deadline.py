"""The time limit of one check after a stop: servos that fail, and time that this computer lost, extend it."""

from hil.bench.hold.motion_since_stop import WINDOW_NS
from hil.core.clock import nanoseconds
from hil.core.signals import ServoHold

_LATE_LOOKS = 25
"""After the time limit, a momentary doubt is tolerated for this number of samples."""
_LOSSES = 3
"""Number of times that the time limit is extended for servos that fail during the check."""


class HoldCheckDeadline:
    """The time limit of one check.

    Args:
        began_ns: beginning of the check.
        limit_s: time limit, counted from the beginning and from each failure of servos.
        strict: True if the limit is never extended.

    Attributes:
        lost_ns: time that this computer has lost in the check.
    """

    def __init__(self, began_ns: int, limit_s: float, *, strict: bool) -> None:
        self._limit_ns, self._strict = nanoseconds(limit_s), strict
        self._end_ns, self._may_lose_ns = began_ns + self._limit_ns, self._limit_ns
        self._answered, self._losses, self._late_looks = False, 0, 0
        self.lost_ns = 0
        self._clear_ns = self._waited_ns = -WINDOW_NS
        self._waits = self._momentary = False

    def on_servo_status(self, hold: ServoHold) -> None:
        """Process the servos' status; extend the limit for servos that fail now."""
        if hold.trouble and self._answered and self._losses < _LOSSES and not self._strict:
            self._end_ns, self._losses = max(self._end_ns, hold.t_ns + self._limit_ns), self._losses + 1
        self._answered = not hold.trouble

    def on_lost(self, lost_ns: int) -> None:
        """Add time that this computer has lost to the limit, which it doubles at most."""
        self.lost_ns += lost_ns
        added_ns = min(lost_ns, self._may_lose_ns)
        if not self._strict:
            self._end_ns, self._may_lose_ns = self._end_ns + added_ns, self._may_lose_ns - added_ns

    def on_observation(self, t_ns: int, *, doubt: bool, waits: bool) -> None:
        """Process the result of one sample.

        Args:
            t_ns: time of the sample.
            doubt: True if servos or motion contradict HELD.
            waits: True if only the check of propellers without commands is unfinished.
        """
        self._waits = waits
        if waits:
            self._waited_ns = t_ns
        if not doubt:
            self._clear_ns = t_ns
        since_ns = max(self._clear_ns, self._waited_ns) if doubt else self._waited_ns
        self._momentary = t_ns - since_ns < WINDOW_NS

    def is_up(self, now_ns: int) -> bool:
        """Whether the check ends without HELD; counts late samples: call once after each `on_observation`."""
        if now_ns < self._end_ns:
            return False
        self._late_looks += not self._waits
        return self._strict or not self._momentary or self._late_looks > _LATE_LOOKS
