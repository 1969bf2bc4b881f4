"""Records a run: the loop hands a cycle over and continues, a thread encodes, compresses and writes.

The thread is woken for several cycles at once: waking it takes as long as encoding one.
A chunk is closed and flushed at least twice a second, so that a killed process loses at most the last
second. When the disk cannot keep up, or is full, records are lost and counted, and the recorder makes the
loop stop, unless `on_failure` lets it go on.
"""

import json
import logging
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from hil.core.errors import HilError, RecordingError
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.recording.mcap_file import RecordingFile
from hil.support.atomic_files import refused

LOG = logging.getLogger(__name__)

OnFailure = Literal["stop", "go-on"]
_IDLE_S = 0.25
_TOGETHER = 5
_CAPACITY = 1000
_CLOSE_S = 10.0
_Item = tuple[str, Any]


class McapRecorder(Sink):
    """Sink that records every cycle.

    Args:
        path: file to write; its folder must exist.
        header: configuration, calibration, seed, versions; kept as JSON.
        lossless: True to write in the caller's thread and drop nothing (virtual time); otherwise a thread
            writes and a full queue drops the newest record.
        on_failure: reaction of the loop to a lost cycle: `stop`, or `go-on` unrecorded.
        capacity: records that may wait.

    Attributes:
        dropped: cycles refused because the writer could not keep up.
        lost: cycles that were taken and then lost to a failed write or a malformed record.
        failure: reason why writing ended or a record was lost; empty if all is well.

    Raises:
        DataError: the file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        header: Mapping[str, object],
        *,
        lossless: bool,
        on_failure: OnFailure = "stop",
        capacity: int = _CAPACITY,
    ) -> None:
        self.path, self.on_failure = Path(path), on_failure
        self.dropped = self.lost = 0
        self.failure = ""
        self._capacity = capacity
        self._closed = self._broken = self._malformed = False
        self._waiting: deque[_Item] = deque()
        self._handed: deque[_Item] = deque()
        self._something = threading.Event()
        try:
            self._recording = RecordingFile(self.path, header)
        except OSError as error:
            raise refused(Path(path), error) from None
        self._thread: threading.Thread | None = None
        if not lossless:
            self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
            self._thread.start()

    @property
    def written(self) -> int:
        """Cycles in the file or in its open chunk."""
        return self._recording.flushed + self._recording.unflushed

    def write(self, record: CycleRecord) -> None:
        """Take the record of one cycle."""
        self._put(("cycle", record))

    def objection(self) -> RecordingError | None:
        """Error that stops the loop once a cycle is lost; None before, and if the loop may go on."""
        if self.on_failure == "go-on" or not self.shortfall:
            return None
        remedy = "make room or record elsewhere" if not self._malformed else "fix what the error names"
        return RecordingError(
            str(self.path),
            f"recording failed ({self.shortfall}); the robot was stopped, what came before can be read",
            remedy=f"{remedy}; --on-recording-failure go-on drives on unrecorded",
        )

    @property
    def shortfall(self) -> str:
        """Why cycles are missing from the recording; empty while all are in it."""
        if self.dropped and not self.failure:
            return f"the disk does not keep up: {self.dropped} cycles dropped"
        return self.failure

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Record a note between two cycles, such as the start of a run.

        Args:
            t_ns: bench time.
            kind: kind of the note (`run`, `mark`).
            data: JSON values; floats come back exactly.
        """
        self._put(("note", (t_ns, json.dumps({"kind": kind, "data": data}, default=str))))
        self.rest()

    def rest(self) -> None:
        """Hand the records of the last cycle to the writer thread, which works while the loop sleeps."""
        self._handed.extend(self._waiting)
        self._waiting.clear()
        if len(self._handed) >= _TOGETHER:
            self._something.set()

    def _put(self, item: _Item) -> None:
        if self._closed:
            return
        if self._thread is None:
            self._take(item)
        elif len(self._handed) + len(self._waiting) < self._capacity:
            self._waiting.append(item)
        elif item[0] == "cycle":
            self.dropped += 1

    def _take(self, item: _Item) -> None:
        """Write one item; failures are counted, and only errors of a signal handler are raised."""
        kind, value = item
        if self._broken:
            self.lost += kind == "cycle"
            return
        try:
            if kind == "cycle":
                self._recording.add_cycle(value)
            elif kind == "note":
                self._recording.add_note(*value)
            elif kind == "begin":
                self._recording.begin()
            else:
                self._recording.flush()
        except OSError as error:
            self._give_up(error)
        except HilError:  # raised by a signal handler
            raise
        except Exception as error:  # whatever a malformed record leads to must not leave the recorder
            self.lost += kind == "cycle"
            self._malformed = True
            self.failure = f"a record could not be encoded ({error!r})"

    def _give_up(self, error: OSError) -> None:
        self._broken = True
        self.failure = f"writing failed ({error})"
        self.lost += self._recording.abandon()
        LOG.warning("%s: %s; recording ended", self.path, self.failure)

    def _work(self) -> None:
        """Thread: write the items handed over, and close the chunk after a time without any."""
        idle = False
        self._take(("begin", None))
        while True:
            self._something.wait(_IDLE_S)
            self._something.clear()
            nothing_comes = self._closed
            if self._handed:
                idle = False
                while self._handed:
                    self._take(self._handed.popleft())
            elif not idle:
                idle = True
                self._take(("flush", None))
            if nothing_comes:
                return

    def close(self) -> None:
        """Write the rest of the queue and the summary, and report losses. Idempotent; never raises."""
        if self._closed:
            return
        self._closed = True
        if self._thread is not None:
            self.rest()
            self._something.set()
            self._thread.join(_CLOSE_S)
            if self._thread.is_alive():
                self.lost += sum(kind == "cycle" for kind, _ in list(self._handed))
                self.failure = f"the disk did not take the rest within {_CLOSE_S:.0f} s"
                LOG.warning("%s: %s", self.path, self.failure)
                return
        if not self._broken:
            try:
                self._recording.finish()
            except OSError as error:
                self._give_up(error)
        if self.dropped or self.lost:
            LOG.warning(
                "%s: %d cycles dropped, %d lost. %s", self.path, self.dropped, self.lost, self.failure
            )

    def report(self) -> dict[str, object]:
        """Counts for a summary: path, written, dropped, lost, failure."""
        return {
            "path": str(self.path),
            "written": self.written,
            "dropped": self.dropped,
            "lost": self.lost,
            "failure": self.failure,
        }
