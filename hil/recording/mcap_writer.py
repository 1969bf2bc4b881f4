"""Writes a recording: an MCAP file with ROS 2 messages and the exact cycle records.

The loop hands a record over and goes on; a thread encodes, compresses and writes. A chunk is closed
and flushed at least twice a second, so that a killed process loses at most the last second. When the
disk cannot keep up, or is full, records are lost, counted and named; the loop never notices.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import struct
import threading
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil.clock import NS_PER_S
from hil.errors import DataError
from hil.interfaces import Sink
from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_layout import describe
from hil.recording.ros_messages import TOPICS, messages, octet_array, string
from hil.signals import CycleRecord

LOG = logging.getLogger(__name__)

METADATA = "hil"
_FLUSH_NS = NS_PER_S // 2
_IDLE_S = 0.25
_CAPACITY = 1000
_CLOSE_S = 10.0
_Item = tuple[str, Any]


@lru_cache(maxsize=1)
def _definitions() -> dict[str, str]:
    """Message definitions of the types in `TOPICS`, by type name."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    return {kind: store.generate_msgdef(kind, ros_version=2)[0] for kind in sorted(set(TOPICS.values()))}


class _WholeWrites:
    """A file in which a write is complete or raises, without a buffer that could outlive a failure."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        self._at = 0

    def write(self, data: bytes) -> int:
        """Hand all of `data` to the operating system."""
        left = memoryview(data)
        while left:
            done = os.write(self._fd, left)
            left, self._at = left[done:], self._at + done
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._at

    def flush(self) -> None:
        """Nothing is held back."""

    def cut(self, length: int) -> None:
        """Drop everything after the first `length` bytes."""
        os.ftruncate(self._fd, length)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._fd)


class _RecordingFile:
    """The MCAP file itself; single-threaded."""

    def __init__(self, path: Path, header: Mapping[str, object]) -> None:
        from mcap.writer import CompressionType, Writer

        self._file = _WholeWrites(path)
        self._encoder = CycleEncoder()
        self._sequence = dict.fromkeys(TOPICS, 0)
        self._flushed_ns: int | None = None
        self._safe_bytes = 0
        self.flushed = self.unflushed = 0
        self._mcap = Writer(self._file, compression=CompressionType.ZSTD, chunk_size=1 << 30)
        self._mcap.start(profile="ros2", library="hil")
        self._mcap.add_metadata(
            METADATA,
            {"header": json.dumps(header, default=str), "layout": json.dumps(describe())},
        )
        schemas = {
            kind: self._mcap.register_schema(kind, "ros2msg", text.encode())
            for kind, text in _definitions().items()
        }
        self._channels = {
            topic: self._mcap.register_channel(topic, "cdr", schemas[kind], {"offered_qos_profiles": ""})
            for topic, kind in TOPICS.items()
        }
        self._safe_bytes = self._file.tell()

    def _add(self, topic: str, log_ns: int, t_ns: int, data: bytes) -> None:
        self._mcap.add_message(
            self._channels[topic], max(0, log_ns), data, max(0, t_ns), self._sequence[topic] & 0xFFFFFFFF
        )
        self._sequence[topic] += 1

    def add_cycle(self, record: CycleRecord) -> None:
        """Add one cycle; flushes by the records' own time."""
        now_ns = record.start_ns
        payload = octet_array(self._encoder.encode(record))
        self._add("/hil/cycle", now_ns, record.inputs.t_ns, payload)
        self.unflushed += 1
        for topic, t_ns, data in messages(record):
            self._add(topic, now_ns, t_ns, data)
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        if not 0 <= now_ns - self._flushed_ns < _FLUSH_NS:
            self._flushed_ns = now_ns
            self.flush()

    def add_note(self, t_ns: int, text: str) -> None:
        """Add one free note."""
        self._add("/hil/notes", t_ns, t_ns, string(text))

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._mcap.flush()
        self._safe_bytes = self._file.tell()
        self.flushed += self.unflushed
        self.unflushed = 0

    def finish(self) -> None:
        """Write the summary and close."""
        self.flush()
        self._mcap.finish()
        self._file.close()

    def abandon(self) -> int:
        """Cut off what was half written and close; returns the number of cycles that are lost with it."""
        lost, self.unflushed = self.unflushed, 0
        try:
            self._file.cut(self._safe_bytes)
            self._file.close()
        except OSError as error:
            LOG.warning("the recording cannot be cut to its last whole chunk (%s)", error)
        return lost


class McapRecorder(Sink):
    """Sink that records every cycle.

    Args:
        path: file to write; its folder must exist.
        header: configuration, calibration, seed, versions; kept as JSON.
        lossless: write in the caller's thread and drop nothing (virtual time); otherwise a thread
            writes and a full queue drops the newest record.
        capacity: records that may wait.

    Attributes:
        dropped: cycles refused because the writer could not keep up.
        lost: cycles that were taken and then lost to a failed write or a malformed record.
        failure: why writing ended or a record was lost; empty if all is well.

    Raises:
        DataError: the file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        header: Mapping[str, object],
        *,
        lossless: bool,
        capacity: int = _CAPACITY,
    ) -> None:
        self.path = Path(path)
        self.dropped = self.lost = 0
        self.failure = ""
        self._capacity = capacity
        self._closed = self._broken = False
        self._queue: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        try:
            self._recording = _RecordingFile(self.path, header)
        except OSError as error:
            raise DataError(
                str(path), f"cannot be written ({error})", remedy="choose a folder that exists and has room"
            ) from None
        self._thread: threading.Thread | None = None
        if not lossless:
            self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
            self._thread.start()

    @property
    def written(self) -> int:
        """Cycles in the file or in its open chunk."""
        return self._recording.flushed + self._recording.unflushed

    def write(self, record: CycleRecord) -> None:
        """Take one record."""
        self._put(("cycle", record))

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Keep something that belongs between two cycles, such as how a run starts.

        Args:
            t_ns: bench time.
            kind: what it is (`run`, `mark`).
            data: JSON values; floats come back exactly.
        """
        self._put(("note", (t_ns, json.dumps({"kind": kind, "data": data}, default=str))))

    def _put(self, item: _Item) -> None:
        if self._closed:
            return
        if self._thread is None:
            self._take(item)
        elif self._queue.qsize() < self._capacity:
            self._queue.put(item)
        elif item[0] == "cycle":
            self.dropped += 1

    def _take(self, item: _Item) -> None:
        """Write one item; whatever fails is counted, nothing leaves."""
        kind, value = item
        if self._broken:
            self.lost += kind == "cycle"
            return
        try:
            if kind == "cycle":
                self._recording.add_cycle(value)
            elif kind == "note":
                self._recording.add_note(*value)
            else:
                self._recording.flush()
        except OSError as error:
            self._give_up(error)
        except (struct.error, AttributeError, TypeError, ValueError, KeyError) as error:
            self.lost += kind == "cycle"
            self.failure = f"a record could not be encoded ({error!r})"

    def _give_up(self, error: OSError) -> None:
        self._broken = True
        self.failure = f"writing failed ({error})"
        self.lost += self._recording.abandon()
        LOG.warning("%s: %s; recording ended, the loop goes on", self.path, self.failure)

    def _work(self) -> None:
        idle = False
        while True:
            try:
                item = self._queue.get(timeout=_IDLE_S)
            except queue.Empty:
                if not idle:
                    self._take(("flush", None))
                idle = True
                continue
            if item[0] == "end":
                return
            idle = False
            self._take(item)

    def close(self) -> None:
        """Write what waits, the summary, and report losses. Idempotent; never raises."""
        if self._closed:
            return
        self._closed = True
        if self._thread is not None:
            self._queue.put(("end", None))
            self._thread.join(_CLOSE_S)
            if self._thread.is_alive():
                self.lost += self._queue.qsize()
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
