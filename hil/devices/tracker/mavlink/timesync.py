"""Maps the sender's clock to the bench clock by TIMESYNC (111) round trips.

A request carries the bench time; the answer carries it back with the sender's own. Half way between
leaving and arrival the sender read its clock, if both ways take equally long: what one way takes longer
than the other is an error of half that, which no round trip can show. The shortest trip of the last
seconds counts, because waiting only ever adds.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from hil.core.clock import nanoseconds

_QUICK_NS, _STEADY_NS = nanoseconds(0.02), nanoseconds(0.2)
_QUICK_TRIPS = 5
_WINDOW_NS = nanoseconds(5.0)
_FORGET_NS = nanoseconds(10.0)
_LONGEST_NS = nanoseconds(0.25)
_DRIFT, _SLACK_NS = 500e-6, 1_000_000
_OPEN_REQUESTS = 16


class Trip(NamedTuple):
    """One round trip: when it ended, how long it took, and bench clock less sender's clock by it."""

    arrived_ns: int
    duration_ns: int
    offset_ns: int


class TimeSync:
    """Round trips with one sender.

    Attributes:
        trips: answers taken since `reset`.
        steps: how often the sender's clock has jumped by more than two trips can explain.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen before."""
        self._asked: deque[int] = deque(maxlen=_OPEN_REQUESTS)
        self._window: deque[Trip] = deque()
        self._best: Trip | None = None
        self._next_ns = 0
        self.trips = self.steps = 0

    def due(self, now_ns: int) -> bool:
        """Whether to ask now; counts as asked at `now_ns`."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + (_QUICK_NS if self.trips < _QUICK_TRIPS else _STEADY_NS)
        self._asked.append(now_ns)
        return True

    def answered(self, asked_ns: int, device_ns: int, arrived_ns: int) -> bool:
        """Take an answer; False for one that was not asked for, or that took too long to be of use."""
        if asked_ns not in self._asked:
            return False
        self._asked.remove(asked_ns)
        duration_ns = arrived_ns - asked_ns
        if not 0 <= duration_ns < _LONGEST_NS:
            return False
        trip = Trip(arrived_ns, duration_ns, (asked_ns + arrived_ns) // 2 - device_ns)
        if self._best is not None and self._contradicts(self._best, trip):
            self._window.clear()
            self.steps += 1
        self._window.append(trip)
        while arrived_ns - self._window[0].arrived_ns > _WINDOW_NS:
            self._window.popleft()
        self._best = min(reversed(self._window), key=lambda seen: seen.duration_ns)
        self.trips += 1
        return True

    def best(self, now_ns: int) -> Trip | None:
        """The trip that counts; None when none has been answered for long."""
        if self._window and now_ns - self._window[-1].arrived_ns > _FORGET_NS:
            self._window.clear()
            self._best = None
        return self._best

    @staticmethod
    def _contradicts(known: Trip, new: Trip) -> bool:
        """Whether no drifting clock can have given both: each is right within half its duration."""
        drift_ns = _DRIFT * (new.arrived_ns - known.arrived_ns)
        possible_ns = (known.duration_ns + new.duration_ns) / 2 + drift_ns + _SLACK_NS
        return abs(new.offset_ns - known.offset_ns) > possible_ns
