"""Reads recordings made by `hil.recording.mcap_writer`, whole or damaged.

What can be read is read; what cannot is named in `problems`. A file without our header is refused
with `DataError`: recordings of other robots are read with a topic mapping (`hil.datasets.rosbag`).
"""

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.core.clock import WallOffset
from hil.core.errors import ConfigError, DataError
from hil.core.signals import CycleRecord
from hil.recording.cycle_codec import FORMAT, CycleCodec
from hil.recording.mcap_file import CLOCK_AT_END, CLOCK_AT_START, FORMAT_KEY, METADATA, PACKAGES
from hil.recording.mcap_scan import COPY_AGAIN, in_place_of, messages_of, records_of
from hil.recording.needed_packages import added_kinds
from hil.recording.topics import TOPICS
from hil.support.file_reading import json_object

_LOG = logging.getLogger(__name__)

NEEDS_TOPICS = "recordings of other robots need a topic mapping (--topics FILE)"
_KEEP_METADATA = (
    "convert the original again by a program that keeps metadata records (`mcap filter --include-metadata`, "
    "`pymcap-cli filter --metadata include`); `ros2 bag convert` and `rosbags-convert` do not keep them"
)
_CYCLE, _NOTE = "/hil/cycle", "/hil/notes"
GO_ON = "give a list as `problems` to go on with what could be read"


class Note:
    """A note between two cycles."""

    def __init__(self, kind: str, data: dict[str, Any]) -> None:
        self.kind, self.data = kind, data


class RecordingReader:
    """One pass over a recording.

    Args:
        path: the MCAP file.

    Attributes:
        header: header that the writer was given.
        packages: name and version of the packages that add devices, by `KIND` or `KIND.MODEL`.
        problems: parts that could not be read so far; complete once the iteration has ended.

    Raises:
        DataError: not an MCAP file, not one of ours, or of another format.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.packages: dict[str, Any] = {}
        self.header, self._codec = self._open()

    def _open(self) -> tuple[dict[str, Any], CycleCodec]:
        from mcap.records import Metadata, MetadataIndex

        if self.path.is_dir() or self.path.suffix == ".db3":
            raise DataError(
                str(self.path),
                "is not a recording of this project",
                expected="a .mcap file",
                remedy=in_place_of(self.path) or NEEDS_TOPICS,
            )
        problems: list[str] = []
        indexed = -1
        for at, record in records_of(self.path, problems):
            if isinstance(record, Metadata) and record.name == METADATA:
                return self._described(at, record.metadata)
            if isinstance(record, MetadataIndex) and record.name == METADATA:
                indexed = record.offset
        if indexed >= 0:
            problems.append(f"is damaged at byte {indexed}: what says how to read it is not there")
        if problems:
            raise DataError(str(self.path), problems[0], remedy=COPY_AGAIN)
        if next(messages_of(self.path, lambda c: c.topic == _CYCLE, []), None) is None:
            raise DataError(str(self.path), "holds no cycle records of this project", remedy=NEEDS_TOPICS)
        raise DataError(
            str(self.path),
            f"has cycle records, but not the metadata record `{METADATA}` that says how to read them",
            remedy=_KEEP_METADATA,
        )

    def _described(self, at: int, metadata: Mapping[str, str]) -> tuple[dict[str, Any], CycleCodec]:
        """Header, and codec for the cycles, from the metadata record at byte `at`."""
        try:
            header = json_object(metadata["header"])
            found = metadata[FORMAT_KEY]
            if found != str(FORMAT):
                raise DataError(
                    str(self.path),
                    f"is a recording of format {found}",
                    expected=f"format {FORMAT}, which this version writes and reads",
                    remedy="read it with the version that wrote it",
                )
            self.packages = json_object(metadata[PACKAGES])
            return header, CycleCodec(added_kinds(self.packages))
        except ConfigError as error:
            raise ConfigError(
                f"{self.path}: {error.message}", expected=error.expected, remedy=error.remedy
            ) from None
        except (KeyError, ValueError) as error:
            raise DataError(
                str(self.path),
                f"cannot be understood, or is damaged after byte {at} ({error})",
                remedy=f"{COPY_AGAIN}, or read it with the version that wrote it",
            ) from None

    def items(self, every_ns: int = 0) -> Iterator[CycleRecord | Note]:
        """Cycles and notes in the order of their log times, in which they were written.

        A message that stands in the file twice, as a file merged with itself has it, counts once.

        Args:
            every_ns: shortest time between two cycles, ns; those between them are passed over.

        Raises:
            DataError: the file was merged from several recordings.
        """
        from mcap.records import Metadata

        own = (
            r.metadata for _, r in records_of(self.path, []) if isinstance(r, Metadata) and r.name == METADATA
        )
        if (several := len({tuple(sorted(metadata.items())) for metadata in own})) > 1:
            raise DataError(
                str(self.path),
                f"holds {several} recordings in one file, whose cycles cannot be told apart",
                remedy="name the recordings that it was merged from",
            )
        repeated, latest_ns, read, next_ns = 0, -1, set[tuple[str, bytes]](), 0
        for channel, message in messages_of(self.path, lambda c: c.topic in (_CYCLE, _NOTE), self.problems):
            if channel.topic == _CYCLE and every_ns:
                if message.log_time < next_ns:
                    continue
                next_ns = message.log_time + every_ns
            if message.log_time != latest_ns:
                latest_ns, read = message.log_time, set()
            if (channel.topic, message.data) in read:
                repeated += 1
                continue
            read.add((channel.topic, message.data))
            item = self._item(channel.topic, message.data)
            if item is not None:
                yield item
        if repeated:
            _LOG.warning("%s: %d messages that stand twice are read once", self.path, repeated)

    def _item(self, topic: str, data: bytes) -> CycleRecord | Note | None:
        """What a message on one of our own topics holds; None where it cannot be read."""
        from hil.recording.rosbags_adapter import from_cdr

        try:
            held = from_cdr(data, TOPICS[topic]).data
            return self._codec.decode(held.tobytes()) if topic == _CYCLE else _note(held)
        except (ValueError, KeyError, TypeError) as error:
            problem = f"a message on {topic} cannot be read ({error})"
            if problem not in self.problems:
                self.problems.append(problem)
            return None

    def __iter__(self) -> Iterator[CycleRecord]:
        """Cycle records only."""
        return (item for item in self.items() if isinstance(item, CycleRecord))


def _note(text: str) -> Note:
    note = json_object(text)
    if not isinstance(note["kind"], str) or not isinstance(note["data"], dict):
        raise ValueError("a note without kind and data")
    return Note(note["kind"], note["data"])


def read_cycles(path: str | Path, problems: list[str] | None = None) -> Iterator[CycleRecord]:
    """Cycle records of a recording, exactly as they were recorded.

    Args:
        path: the MCAP file.
        problems: list that receives what could not be read. Without it, damage raises after the last readable
            cycle.

    Raises:
        DataError: see `RecordingReader`; also damage when `problems` is None.
    """
    reader = RecordingReader(path)
    yield from reader
    if problems is not None:
        problems += reader.problems
    elif reader.problems:
        raise DataError(str(path), "; ".join(reader.problems), remedy=GO_ON)


def read_wall_offsets(path: str | Path) -> tuple[WallOffset, ...]:
    """Offsets of the wall clock from the bench clock at the start and, after an orderly end, at the end.

    Stamps of the messages use the first; the difference is the adjustment of the wall clock meanwhile. Empty
    for virtual time.

    Raises:
        DataError: not an MCAP file, or damaged where the offsets stand.
    """
    from mcap.records import Metadata

    kept = (r for _, r in records_of(Path(path), []) if isinstance(r, Metadata))
    try:
        return tuple(
            WallOffset(*(int(r.metadata[name]) for name in WallOffset._fields))
            for r in kept
            if r.name in (CLOCK_AT_START, CLOCK_AT_END)
        )
    except (KeyError, ValueError) as error:
        raise DataError(str(path), f"its clock offset cannot be understood ({error!r})") from None


def read_header(path: str | Path) -> dict[str, Any]:
    """Header that the writer was given: configuration, calibration, seed, versions."""
    return RecordingReader(path).header
