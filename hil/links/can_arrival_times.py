"""Maps the arrival times of CAN frames to the bench clock."""

from hil.core.clock import NS_PER_S

_WAITED_NS = 1_000_000_000
_STEPPED_NS = 200_000_000


class ArrivalClock:
    """Bench time of a frame's arrival from the interface's own time stamp.

    Interfaces stamp on a clock of their own (mostly the system's real time). Its offset to the bench
    clock is learnt from frames that were waited for, whose stamp is fresh; without a usable stamp the
    time of draining is used. Frames that have waited for seconds (the bus was not drained) have rising
    stamps; a clock that was set back has stamps that go back, or that stay old however often the bus is
    drained.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        self._stamp_ns = 0
        self._old_since_ns: int | None = None

    def arrival_ns(self, timestamp_s: float, now_ns: int) -> int:
        """Arrival of a frame drained at `now_ns`; never later than that."""
        if timestamp_s <= 0.0:
            return now_ns
        stamp_ns = round(timestamp_s * NS_PER_S)
        offset_ns = now_ns - stamp_ns
        before_ns, self._stamp_ns, known_ns = self._stamp_ns, stamp_ns, self._offset_ns
        if known_ns is not None and before_ns <= stamp_ns and 0 <= offset_ns - known_ns < _WAITED_NS:
            self._old_since_ns = None
            return stamp_ns + known_ns
        if known_ns is None or offset_ns < known_ns or stamp_ns < before_ns or self._stays_old(now_ns):
            self._offset_ns, self._old_since_ns, known_ns = offset_ns, None, offset_ns
        return stamp_ns + known_ns

    def _stays_old(self, now_ns: int) -> bool:
        """Whether only frames that seem to have waited long have come for 0.2 s."""
        if self._old_since_ns is None:
            self._old_since_ns = now_ns
        return now_ns - self._old_since_ns > _STEPPED_NS
