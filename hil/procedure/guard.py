"""Sinks that a run puts on its bench: the recording, and a guard that ends a step in time."""

from __future__ import annotations

from collections.abc import Mapping

from hil.procedure.interrupts import Interrupts
from hil.recording.mcap_writer import McapRecorder, OnFailure
from hil.vocabulary.clock import nanoseconds, seconds
from hil.vocabulary.errors import HilError, StepTimeoutError
from hil.vocabulary.interfaces import Sink
from hil.vocabulary.signals import CycleRecord

_GAP_NS = nanoseconds(10.0)


class LoopGuard(Sink):
    """Ends the loop from within: when a step's time is over, or when a stop was asked for.

    Attributes:
        driven_ns: bench time that the loop has run, over all benches of the run.
    """

    def __init__(self, interrupts: Interrupts) -> None:
        self._interrupts = interrupts
        self._last_ns: int | None = None
        self._limits: list[tuple[str, float, int]] = []
        self.driven_ns = 0

    def push_limit(self, what: str, limit_s: float) -> None:
        """From now on allow `limit_s` of bench time, within the limits that already hold."""
        self._limits.append((what, limit_s, self.driven_ns + nanoseconds(limit_s)))

    def pop_limit(self) -> None:
        """Take back the last limit."""
        self._limits.pop()

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
        """`Aborted` or `StepTimeoutError`, which the loop stops the robot with."""
        stopping = self._interrupts.stopping()
        if stopping is not None:
            return stopping
        over = ((what, limit_s) for what, limit_s, end_ns in self._limits if self.driven_ns > end_ns)
        return next((StepTimeoutError(what, limit_s) for what, limit_s in over), None)

    def close(self) -> None:
        """Forget the last bench's time axis."""
        self._last_ns = None


class RunRecorder(McapRecorder):
    """A recorder that no signal interrupts in the middle of a record.

    Args:
        path: of the recording.
        header: JSON values.
        interrupts: held off while a record is written.
        lossless: drop nothing, for virtual time.
        on_failure: what a disk that takes no more means for the run.
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

    def write(self, record: CycleRecord) -> None:
        """Take one record."""
        with self._interrupts.deferred():
            super().write(record)

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Keep a note.

        Args:
            t_ns: bench time, ns.
            kind: what the note is about.
            data: JSON values.
        """
        with self._interrupts.deferred():
            super().note(t_ns, kind, data)

    def close(self) -> None:
        """Write the rest."""
        with self._interrupts.deferred():
            super().close()
