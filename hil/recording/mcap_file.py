"""The MCAP file of a recording: topics, chunks, metadata, and what is left of it when writing fails."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.core.clock import NS_PER_S, MonotonicClock, WallOffset
from hil.core.signals import KINDS, CycleRecord
from hil.recording.cycle_codec import FORMAT, CycleCodec
from hil.recording.needed_packages import needed_packages, recorded_kinds
from hil.recording.topics import topics_with
from hil.recording.transform_tree import FrameTree, recorded_offset
from hil.recording.urdf import urdf

if TYPE_CHECKING:
    from hil.recording.ros_messages import CycleMessages

LOG = logging.getLogger(__name__)

METADATA, CLOCK_AT_START, CLOCK_AT_END = "hil", "hil_clock_at_start", "hil_clock_at_end"
FORMAT_KEY, PACKAGES = "format", "packages"
LIBRARY = "hil"
"""Name of the writing library in the head of a file."""
_FLUSH_NS = NS_PER_S // 2
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED = "- " + "\n  ".join(
    (
        "history: 1",
        "depth: 1",
        "reliability: 1",
        "durability: 1",
        f"deadline: {_FOREVER}",
        f"lifespan: {_FOREVER}",
        "liveliness: 1",
        f"liveliness_lease_duration: {_FOREVER}",
        "avoid_ros_namespace_conventions: false",
    )
)
_QOS = {"/tf_static": _LATCHED, "/robot_description": _LATCHED}
"""Quality of service for playing a topic: a late subscriber also gets the last message."""


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

    def cut(self, length: int) -> None:
        """Drop everything after the first `length` bytes."""
        os.ftruncate(self._fd, length)

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)


class RecordingFile:
    """The MCAP file itself; single-threaded.

    Every time that other tools read (log time, message stamps) is wall-clock time, by the header's clock
    offset; the cycle records keep the bench clock's own times.

    Args:
        path: file to write.
        header: header of the recording, kept as JSON; contains the clock offset and the mounts of sensors and
            wheels.

    Attributes:
        flushed, unflushed: numbers of cycles handed to the operating system, and in the open chunk.

    Raises:
        OSError: it cannot be created.
        ConfigError: samples or messages of a package cannot be recorded.
    """

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        from hil.recording.mcap_chunks import ChunkedFile

        self._offset = recorded_offset(header)
        self._wall_ns = 0 if self._offset is None else self._offset.offset_ns
        self._frames = FrameTree(header)
        self._description = urdf(header) if "geometry" in header else ""
        self._file = _WholeWrites(path)
        self._kinds = recorded_kinds(header)
        added = tuple(kind for kind in self._kinds if kind.name not in KINDS)
        self._codec = CycleCodec(added)
        self._messages: CycleMessages | None = None
        self._flushed_ns: int | None = None
        self._log_ns = -1
        self.flushed = self.unflushed = 0
        self._mcap = ChunkedFile(self._file, LIBRARY, self._wall_ns)
        self._mcap.add_metadata(
            METADATA,
            {
                "header": json.dumps(header, default=str),
                FORMAT_KEY: str(FORMAT),
                PACKAGES: json.dumps(needed_packages(header)),
            },
        )
        if self._offset is not None:
            self._mcap.add_metadata(CLOCK_AT_START, _texts(self._offset))
        self._safe_bytes = self._file.tell()
        if added:  # a message type that ROS 2 does not have is named before anything is recorded
            self.begin()

    def begin(self) -> CycleMessages:
        """Describe the topics at the first call: this loads rosbags, which takes some tenths of a second."""
        if self._messages is None:
            from hil.recording.ros_messages import CycleMessages
            from hil.recording.rosbags_adapter import definition

            topics = topics_with(self._kinds)
            schemas = {
                name: self._mcap.add_schema(name, definition(name)) for name in sorted(set(topics.values()))
            }
            for topic, name in topics.items():
                about = {"offered_qos_profiles": _QOS.get(topic, "")}
                self._mcap.add_topic(topic, schemas[name], about)
            self._messages = CycleMessages(self._kinds, self._frames, self._wall_ns)
        return self._messages

    def _next_log_ns(self, t_ns: int) -> int:
        """Log time of a cycle or note: after that of the one before, for it alone keeps their order."""
        self._log_ns = max(t_ns + self._wall_ns, self._log_ns + 1)
        return self._log_ns

    def add_cycle(self, record: CycleRecord) -> None:
        """Add one cycle; flushes by the records' own time."""
        now_ns, messages = record.start_ns, self.begin()
        encoded = self._codec.encode(record)
        log_ns = self._next_log_ns(now_ns)
        self._mcap.add(log_ns, [messages.cycle(record.inputs.t_ns, encoded)])
        self.unflushed += 1
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
            self._mcap.add(log_ns, messages.first(now_ns, self._description))
        self._mcap.add(log_ns, messages.of(record))
        if not 0 <= now_ns - self._flushed_ns < _FLUSH_NS:
            self._flushed_ns = now_ns
            self.flush()

    def add_note(self, t_ns: int, note: str) -> None:
        """Add one free note."""
        self._mcap.add(self._next_log_ns(t_ns), [self.begin().note(t_ns, note)])

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self.begin()
        self._mcap.flush()
        self._safe_bytes = self._file.tell()
        self.flushed += self.unflushed
        self.unflushed = 0

    def finish(self) -> None:
        """Write the present clock offset and the summary, and close."""
        self.flush()
        if self._offset is not None:
            self._mcap.add_metadata(CLOCK_AT_END, _texts(MonotonicClock().wall_offset()))
        self._mcap.finish()
        self._file.close()

    def abandon(self) -> int:
        """Cut off everything after the last whole chunk and close; returns the number of lost cycles."""
        lost, self.unflushed = self.unflushed, 0
        try:
            self._file.cut(self._safe_bytes)
            self._file.close()
        except OSError as error:
            LOG.warning("the recording cannot be cut to its last whole chunk (%s)", error)
        return lost


def _texts(offset: WallOffset) -> dict[str, str]:
    return {name: str(value) for name, value in offset._asdict().items()}
