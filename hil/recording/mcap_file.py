"""The MCAP file of a recording: topics, chunks, metadata, and what is left of it when writing fails."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from hil.recording.cdr import octet_array, string
from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_layout import describe
from hil.recording.frames import FrameTree, recorded_offset
from hil.recording.ros_messages import CycleMessages, Message, topics_with, transforms
from hil.recording.urdf import urdf
from hil.vocabulary.clock import NS_PER_S, MonotonicClock, WallOffset
from hil.vocabulary.device import DeviceKind
from hil.vocabulary.errors import ConfigError
from hil.vocabulary.kinds import kinds
from hil.vocabulary.reading import toml_tables
from hil.vocabulary.signals import KINDS, CycleRecord

LOG = logging.getLogger(__name__)

METADATA, CLOCK_AT_START, CLOCK_AT_END = "hil", "hil_clock_at_start", "hil_clock_at_end"
PACKAGES = "packages"
LIBRARY = "hil"
"""What the head of a file says wrote it."""
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
"""Quality of service with which a topic is to be played: who listens later gets the last message, too."""


@cache
def _definitions() -> dict[str, str]:
    """Definitions of the message types that our own topics have; to ask rosbags takes a tenth of a second."""
    text = resources.files("hil.recording").joinpath("message_definitions.toml").read_text(encoding="utf-8")
    return toml_tables(text, "message_definitions.toml")


@cache
def definition(kind: str) -> str:
    """Definition of a message type.

    Raises:
        ConfigError: ROS 2 has no such type.
    """
    if kind in _definitions():
        return _definitions()[kind]
    from rosbags.typesys import Stores, get_typestore

    try:
        found: str = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)[0]
    except Exception as error:
        raise ConfigError(f"message type {kind!r} cannot be recorded ({error})") from error
    return found


def _recorded(header: Mapping[str, Any]) -> tuple[DeviceKind, ...]:
    """Kinds whose samples a recording holds: all of ours, and those of other packages that its bench has."""
    present = header.get("config", {})
    return tuple(kind for name, kind in kinds().items() if name in KINDS or present.get(name) is not None)


def _packages(header: Mapping[str, Any]) -> dict[str, str]:
    """Packages without which a recording cannot be read, by kind, or `KIND.MODEL` where they add a model."""
    found = {}
    for name, table in header.get("config", {}).items():
        kind = kinds().get(name)
        if kind is not None and isinstance(table, Mapping):
            model = next((m for m in kind.models if m.name == table.get("model")), kind.models[0])
            if name not in KINDS:
                found[name] = kind.package
            if model.package != kind.package:
                found[f"{name}.{model.name}"] = model.package
    return found


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


class _Channel:
    """A topic in the file, by the library's number for it, and how many messages it has."""

    __slots__ = ("id", "sent")

    def __init__(self, number: int) -> None:
        self.id, self.sent = number, 0


class RecordingFile:
    """The MCAP file itself; single-threaded.

    Every time that other tools read (log time, message stamps) is wall-clock time, by the header's clock
    offset; the cycle records keep the bench clock's own times.

    Args:
        path: file to write.
        header: kept as JSON; says where the clock stands and how sensors and wheels are mounted.

    Attributes:
        flushed, unflushed: cycles that the operating system has, and those of the open chunk.

    Raises:
        OSError: it cannot be created.
    """

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        from mcap.writer import CompressionType, Writer

        self._offset = recorded_offset(header)
        self._wall_ns = 0 if self._offset is None else self._offset.offset_ns
        self._frames = FrameTree(header)
        self._description = urdf(header) if "geometry" in header else ""
        self._file = _WholeWrites(path)
        recorded = _recorded(header)
        own = tuple(kind for kind in recorded if kind.name not in KINDS)
        self._encoder = CycleEncoder(own)
        self._messages = CycleMessages(recorded, self._frames, self._wall_ns)
        topics = topics_with(recorded)
        self._flushed_ns: int | None = None
        self._safe_bytes = 0
        self.flushed = self.unflushed = 0
        self._mcap = Writer(self._file, compression=CompressionType.ZSTD, chunk_size=1 << 30)
        self._mcap.start(profile="ros2", library=LIBRARY)
        self._mcap.add_metadata(
            METADATA,
            {
                "header": json.dumps(header, default=str),
                "layout": json.dumps(describe(own)),
                PACKAGES: json.dumps(_packages(header)),
            },
        )
        if self._offset is not None:
            self._mcap.add_metadata(CLOCK_AT_START, _texts(self._offset))
        schemas = {
            kind: self._mcap.register_schema(kind, "ros2msg", definition(kind).encode())
            for kind in sorted(set(topics.values()))
        }
        self._channels = {
            topic: _Channel(
                self._mcap.register_channel(
                    topic, "cdr", schemas[kind], {"offered_qos_profiles": _QOS.get(topic, "")}
                )
            )
            for topic, kind in topics.items()
        }
        self._safe_bytes = self._file.tell()

    def _add(self, log_ns: int, items: Iterable[Message]) -> None:
        """Add messages, all logged at one time."""
        add_message, channels, wall_ns = self._mcap.add_message, self._channels, self._wall_ns
        log_ns = max(0, log_ns + wall_ns)
        for topic, t_ns, data in items:
            channel, t_ns = channels[topic], t_ns + wall_ns
            add_message(channel.id, log_ns, data, t_ns if t_ns > 0 else 0, channel.sent & 0xFFFFFFFF)
            channel.sent += 1

    def add_cycle(self, record: CycleRecord) -> None:
        """Add one cycle; flushes by the records' own time."""
        now_ns = record.start_ns
        payload = octet_array(self._encoder.encode(record))
        self._add(now_ns, [("/hil/cycle", record.inputs.t_ns, payload)])
        self.unflushed += 1
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
            self._add(now_ns, self._first(now_ns))
        self._add(now_ns, self._messages.of(record))
        if not 0 <= now_ns - self._flushed_ns < _FLUSH_NS:
            self._flushed_ns = now_ns
            self.flush()

    def _first(self, t_ns: int) -> Iterator[Message]:
        """What never moves, once in a recording."""
        yield "/tf_static", t_ns, transforms(t_ns, self._frames.fixed, self._wall_ns)
        if self._description:
            yield "/robot_description", t_ns, string(self._description)

    def add_note(self, t_ns: int, text: str) -> None:
        """Add one free note."""
        self._add(t_ns, [("/hil/notes", t_ns, string(text))])

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._mcap.flush()
        self._safe_bytes = self._file.tell()
        self.flushed += self.unflushed
        self.unflushed = 0

    def finish(self) -> None:
        """Write where the clock stands now and the summary, and close."""
        self.flush()
        if self._offset is not None:
            self._mcap.add_metadata(CLOCK_AT_END, _texts(MonotonicClock().wall_offset()))
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


def _texts(offset: WallOffset) -> dict[str, str]:
    return {name: str(value) for name, value in offset._asdict().items()}
