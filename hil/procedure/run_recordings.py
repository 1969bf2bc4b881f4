"""The recordings of a run: where each is written, how it becomes known, and what is missing from it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import DataError, RecordingError
from hil.procedure.run_outputs import RunOutputs, slug
from hil.procedure.step_timer import RunRecorder
from hil.procedure.stop_requests import Interrupts
from hil.recording.mcap_writer import OnFailure

if TYPE_CHECKING:
    from hil.bench import Bench


class Recordings:
    """All recordings of one run.

    Args:
        results: takes the recordings that begin, and what is missing from one.
        interrupts: held off while a record is written.
        on_failure: as in the attribute.

    Attributes:
        on_failure: what a disk that takes no more means for the run.
    """

    def __init__(self, results: RunOutputs, interrupts: Interrupts, on_failure: OnFailure) -> None:
        self.on_failure: OnFailure = on_failure
        self._results, self._interrupts = results, interrupts
        self._recorders: list[RunRecorder] = []
        self._newest: RunRecorder | None = None
        self._objections: list[RecordingError] = []

    def path(self, label: str, taken: Sequence[Path | None] = ()) -> Path | None:
        """Where the recording of this label goes: no file that exists, nor one of `taken`; None for none."""
        if self._results.keep == "results":
            return None
        stem = f"recording_{slug(label)}" if label else "recording"
        path, number = self._results.folder / f"{stem}.mcap", 1
        while path.exists() or path in taken:
            number += 1
            path = self._results.folder / f"{stem}-{number}.mcap"
        return path

    def record(self, bench: Bench, label: str, *, lossless: bool) -> None:
        """Have a bench recorded; one that cannot be is an error unless the run may go on without.

        Raises:
            DataError: the file cannot be created.
        """
        path, self._newest = self.path(label), None
        if path is None:
            return
        try:
            recorder = RunRecorder(
                str(path), bench.header(), self._interrupts, lossless=lossless, on_failure=self.on_failure
            )
        except DataError as error:
            if self.on_failure == "stop":
                raise
            self._results.note_in_any_case(str(error))
            return
        bench.add_sink(recorder)
        self._newest = recorder
        self._recorders.append(recorder)
        self.add(path)

    def add(self, path: Path) -> None:
        """Make a recording known that has begun."""
        self._results.findings.recordings.append(path.name)
        self._results.journal.add("recording", {"path": path.name})

    def object(self, objection: RecordingError) -> None:
        """Keep what is wrong with a recording that another process wrote."""
        self._objections.append(objection)

    def finish(self) -> None:
        """Tell what is missing from the newest, whose bench was closed."""
        if self._newest is not None and self._newest.shortfall:
            self._results.note_in_any_case(
                f"{self._newest.path.name} is not complete: {self._newest.shortfall}"
            )

    def objection(self) -> RecordingError | None:
        """What the run has to end with when cycles are missing; None if it need not."""
        return next(filter(None, (*self._objections, *(r.objection() for r in self._recorders))), None)
