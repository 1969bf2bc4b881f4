"""Sinks that a run adds to its bench: the recorder, and a timer that enforces step time limits."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from hil.core.clock import Clock, nanoseconds, seconds
from hil.core.errors import HilError, StepTimeoutError
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.procedure.interrupts import Interrupts
from hil.recording.mcap_writer import McapRecorder, OnFailure

_GAP_NS = nanoseconds(10.0)
_LOOP_FIRST_NS = nanoseconds(1.0)
"""Delay of the clock alarm, so that a running loop can end the step first, between two cycles."""


class StepTimer(Sink):
    """Ends the loop when the time limit of a step has passed, or after a stop request.

    Step time is the time of the bench's clock while a bench is open, whether its loop runs or not. In
    virtual time an alarm of the clock ends a step that waits without a loop; in real time the limit is
    checked when such a step ends.

    Attributes:
        driven_ns: bench time that the loop has run, over all benches of the run.
    """

    def __init__(self, interrupts: Interrupts) -> None:
        self._interrupts = interrupts
        self._last_ns: int | None = None
        self._limits: list[tuple[str, float, int]] = []
        self._clock: Clock | None = None
        self._virtual = False
        self._since_ns = self._before_ns = 0
        self._forget_alarm: Callable[[], None] = _nothing
        self.driven_ns = 0

    def watch(self, clock: Clock, *, virtual: bool) -> None:
        """Start to count the time of an opened bench.

        Args:
            clock: clock of the bench.
            virtual: True if its time advances only while a caller waits.
        """
        self._clock, self._virtual, self._since_ns = clock, virtual, clock.now_ns()
        self._set_alarm()

    def leave(self) -> None:
        """Stop counting: the bench will be closed, and no limit interrupts this. Idempotent."""
        self._before_ns, self._clock = self._passed_ns, None
        self._set_alarm()

    def add(self, driven_s: float) -> None:
        """Add the time, s, of a bench that another process has driven."""
        self.driven_ns += nanoseconds(driven_s)
        self._before_ns += nanoseconds(driven_s)
        self._set_alarm()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pause the count while a person is asked."""
        begin_ns = self._passed_ns
        try:
            yield
        finally:
            self._before_ns -= self._passed_ns - begin_ns

    def push_limit(self, what: str, limit_s: float) -> None:
        """Start a limit of `limit_s` of bench time, within the current limits."""
        self._limits.append((what, limit_s, self._passed_ns + nanoseconds(limit_s)))
        self._set_alarm()

    def pop_limit(self) -> None:
        """Remove the last limit."""
        self._limits.pop()
        self._set_alarm()

    def must_be_in_time(self) -> None:
        """Raise `StepTimeoutError` if a limit has passed."""
        late = self._late()
        if late is not None:
            raise late

    @property
    def passed_s(self) -> float:
        """Bench time that has passed while a bench was open, s."""
        return seconds(self._passed_ns)

    @property
    def _passed_ns(self) -> int:
        return self._before_ns + (0 if self._clock is None else self._clock.now_ns() - self._since_ns)

    def _late(self) -> StepTimeoutError | None:
        passed_ns = self._passed_ns
        over = ((what, limit_s) for what, limit_s, end_ns in self._limits if passed_ns > end_ns)
        return next((StepTimeoutError(what, limit_s) for what, limit_s in over), None)

    def _set_alarm(self) -> None:
        """Schedule an alarm on the virtual clock that ends a call which sleeps past the nearest limit."""
        self._forget_alarm()
        self._forget_alarm = _nothing
        if self._clock is not None and self._virtual and self._limits:
            left_ns = min(end_ns for _, _, end_ns in self._limits) - self._passed_ns
            due_ns = self._clock.now_ns() + max(left_ns, 0) + _LOOP_FIRST_NS
            self._forget_alarm = self._clock.schedule(self._alarm, due_ns)

    def _alarm(self, now_ns: int) -> int:
        self._forget_alarm()
        self.must_be_in_time()
        return now_ns

    @property
    def driven_s(self) -> float:
        """Bench time that the loop has run, s."""
        return seconds(self.driven_ns)

    def write(self, record: CycleRecord) -> None:
        """Count the time of one cycle."""
        if self._last_ns is not None:
            self.driven_ns += min(max(0, record.start_ns - self._last_ns), _GAP_NS)
        self._last_ns = record.start_ns

    def objection(self) -> HilError | None:
        """Return `Aborted` or `StepTimeoutError`, with which the loop stops the robot; None to go on."""
        stopping = self._interrupts.stopping()
        if stopping is not None:
            return stopping
        return self._late()

    def close(self) -> None:
        """Forget the last bench's time axis."""
        self._last_ns = None


def _nothing() -> None:
    """Cancel function for an alarm that was not set."""


class RunRecorder(McapRecorder):
    """A recorder that a signal does not interrupt within a note; the loop sees to its records.

    Args:
        path: file of the recording.
        header: JSON values.
        interrupts: signals, deferred while a note is written and the file is closed.
        lossless: True to drop no records, for virtual time.
        on_failure: reaction to a full disk: `stop`, or `go-on`.
    """

    def __init__(
        self,
        path: str,
        header: Mapping[str, object],
        interrupts: Interrupts,
        *,
        lossless: bool,
        on_failure: OnFailure,
    ) -> None:
        self._interrupts = interrupts
        super().__init__(path, header, lossless=lossless, on_failure=on_failure)

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Write a note.

        Args:
            t_ns: bench time, ns.
            kind: subject of the note.
            data: JSON values.
        """
        with self._interrupts.deferred():
            super().note(t_ns, kind, data)

    def close(self) -> None:
        """Write the remaining data and close the file."""
        with self._interrupts.deferred():
            super().close()
