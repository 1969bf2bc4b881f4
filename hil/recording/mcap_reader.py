"""Reads recordings made by `hil.recording.mcap_writer`, whole or damaged.

What can be read is read; what cannot is named in `problems`. A file without our header is refused
with `DataError`: recordings of other robots are read with a topic mapping (`hil.recording.rosbag`).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from hil.recording.cdr import octets_of, text_of
from hil.recording.cycle_decoder import CycleDecoder, StoredCycle
from hil.recording.cycle_layout import check_packages
from hil.recording.mcap_file import CLOCK_AT_END, CLOCK_AT_START, METADATA, PACKAGES
from hil.recording.unpacking import Allowance, chunk_data
from hil.vocabulary.clock import WallOffset
from hil.vocabulary.errors import ConfigError, DataError
from hil.vocabulary.reading import json_object
from hil.vocabulary.signals import CycleRecord

NEEDS_TOPICS = "recordings of other robots need a topic mapping (--topics FILE)"
_CYCLE, _NOTE = "/hil/cycle", "/hil/notes"
_RECORD, _CHANNEL_ID = struct.Struct("<BQ"), struct.Struct("<H")
_MESSAGE_HEAD = 2 + 4 + 8 + 8

Cycle = TypeVar("Cycle", CycleRecord, StoredCycle)


class Note:
    """Something kept between two cycles."""

    def __init__(self, kind: str, data: dict[str, Any]) -> None:
        self.kind, self.data = kind, data


class RecordingReader:
    """One pass over a recording.

    Args:
        path: the MCAP file.

    Attributes:
        header: what the writer was given.
        problems: what could not be read so far; complete once the iteration has ended.

    Raises:
        DataError: not an MCAP file, not one of ours, or of a newer format.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.header, self._decoder = self._open()
        self.problems += self._decoder.notes

    def _open(self) -> tuple[dict[str, Any], CycleDecoder]:
        from mcap.records import Chunk, Metadata

        if self.path.is_dir() or self.path.suffix == ".db3":
            raise DataError(
                str(self.path),
                "is not a recording of this project",
                expected="a .mcap file",
                remedy=NEEDS_TOPICS,
            )
        for record in _records(self.path, []):
            if isinstance(record, Metadata) and record.name == METADATA:
                try:
                    check_packages(json_object(record.metadata.get(PACKAGES, "{}")))
                    header = json_object(record.metadata["header"])
                    return header, CycleDecoder(json_object(record.metadata["layout"]))
                except ConfigError as error:
                    raise ConfigError(
                        f"{self.path}: {error.message}", expected=error.expected, remedy=error.remedy
                    ) from None
                except (KeyError, ValueError) as error:
                    raise DataError(
                        str(self.path),
                        f"cannot be understood ({error})",
                        remedy="read it with the version that wrote it",
                    ) from None
            if isinstance(record, Chunk):
                break
        raise DataError(str(self.path), "holds no cycle records of this project", remedy=NEEDS_TOPICS)

    def items(self) -> Iterator[CycleRecord | Note]:
        """Cycles and notes in the order in which they were written."""
        return self._items(self._decoder.decode)

    def stored(self) -> Iterator[StoredCycle | Note]:
        """As `items`, with no more of the cycles read than it takes to decide again."""
        return self._items(self._decoder.begin)

    def _items(self, cycle_of: Callable[[bytes], Cycle]) -> Iterator[Cycle | Note]:
        from mcap.exceptions import McapError
        from mcap.records import Chunk

        allowance = Allowance(self.path, self.path.stat().st_size)
        topics: dict[int, str] = {}
        cycles = 0
        for record in _records(self.path, self.problems):
            if not isinstance(record, Chunk):
                continue
            try:
                parts = _ours(chunk_data(record, allowance), topics)
            except DataError as error:
                why = error.message.removeprefix(f"{self.path}: ")
                self.problems.append(f"{why}: what follows cycle {cycles} was not read")
                return
            except (McapError, ValueError, EOFError, MemoryError, struct.error) as error:
                self.problems.append(f"a chunk after cycle {cycles} is damaged ({error})")
                continue
            for topic, data in parts:
                try:
                    item = cycle_of(octets_of(data)) if topic == _CYCLE else _note(data)
                except (ValueError, KeyError, TypeError) as error:
                    self.problems.append(f"a message on {topic} cannot be read ({error})")
                    continue
                cycles += topic == _CYCLE
                yield item

    def __iter__(self) -> Iterator[CycleRecord]:
        """Cycle records only."""
        return (item for item in self.items() if isinstance(item, CycleRecord))


def _note(data: bytes) -> Note:
    note = json_object(text_of(data))
    if not isinstance(note["kind"], str) or not isinstance(note["data"], dict):
        raise ValueError("a note without kind and data")
    return Note(note["kind"], note["data"])


def _ours(data: bytes, topics: dict[int, str]) -> list[tuple[str, bytes]]:
    """Topic and payload of a chunk's messages on our own topics; new channels go into `topics`.

    The records of a chunk are told apart by hand: nine of ten are for other tools, and parsing all of them
    is what takes the official reader its time (mcap.dev/spec, "Records").

    Raises:
        McapError, ValueError, struct.error: the chunk is damaged.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel

    length, at = len(data), 0
    found = []
    while at < length:
        opcode, size = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if at + size > length:
            raise ValueError("a record runs beyond the end of its chunk")
        if opcode == Opcode.MESSAGE:
            topic = topics.get(_CHANNEL_ID.unpack_from(data, at)[0])
            if topic in (_CYCLE, _NOTE):
                found.append((topic, data[at + _MESSAGE_HEAD : at + size]))
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(data[at : at + size])))
            topics[channel.id] = channel.topic
        at += size
    return found


def top_level(stream: BinaryIO, limit: int) -> Iterator[tuple[int, Any]]:
    """Top-level records, in their order, with the byte at which each begins.

    Chunks and their indices, metadata and footer are parsed, None stands for every other: nine of ten are
    message indices, which a pass from the beginning does not need.

    Args:
        stream: the file.
        limit: most bytes of a record.

    Raises:
        McapError, ValueError, struct.error: damaged.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
    from mcap.opcode import Opcode
    from mcap.records import Chunk, ChunkIndex, Footer, Metadata
    from mcap.stream_reader import read_magic

    wanted: dict[int, Any] = {
        Opcode.CHUNK: Chunk, Opcode.CHUNK_INDEX: ChunkIndex, Opcode.METADATA: Metadata,
        Opcode.FOOTER: Footer,
    }  # fmt: skip
    source = ReadDataStream(stream)
    read_magic(source)
    opcode = None
    while opcode != Opcode.FOOTER:
        at = source.count
        opcode, length = _RECORD.unpack(source.read(_RECORD.size))
        if length > limit:
            raise RecordLengthLimitExceeded(opcode, length, limit)
        data, kind = source.read(length), wanted.get(opcode)
        if len(data) < length:
            raise EndOfFile
        yield at, None if kind is None else kind.read(ReadDataStream(io.BytesIO(data)))
    read_magic(source)


def _records(path: Path, problems: list[str]) -> Iterator[Any]:
    """Records that `top_level` gives; a file that ends early ends the iteration and is named in `problems`.

    Raises:
        DataError: not there or not MCAP.
    """
    from mcap.exceptions import InvalidMagic, McapError

    try:
        with path.open("rb") as stream:
            records, count = top_level(stream, max(1, path.stat().st_size)), 0
            while True:
                try:
                    _, record = next(records)
                except StopIteration:
                    return
                except (InvalidMagic, struct.error) as error:
                    if count == 0:
                        raise DataError(
                            str(path), "is not an MCAP file", expected="a recording (.mcap)"
                        ) from None
                    problems.append(_ended(stream.tell(), error))
                    return
                except (McapError, ValueError, EOFError, MemoryError) as error:
                    if count == 0:
                        why = str(error) or "it is empty or ends within its first record"
                        raise DataError(str(path), f"is not a readable MCAP file ({why})") from None
                    problems.append(_ended(stream.tell(), error))
                    return
                count += 1
                yield record
    except OSError as error:
        raise DataError(str(path), f"cannot be read ({error.strerror or error})") from None


def _ended(at: int, error: Exception) -> str:
    why = f": {error}" if str(error) else ""
    return f"ends early at byte {at} (writer killed or disk full){why}"


def read_cycles(path: str | Path, problems: list[str] | None = None) -> Iterator[CycleRecord]:
    """Cycle records of a recording, exactly as they were recorded.

    Args:
        path: the MCAP file.
        problems: receives what could not be read. Without it, damage raises after the last readable cycle.

    Raises:
        DataError: see `RecordingReader`; also damage when `problems` is None.
    """
    reader = RecordingReader(path)
    yield from reader
    if problems is not None:
        problems += reader.problems
    elif reader.problems:
        raise DataError(str(path), "; ".join(reader.problems), remedy="what was readable has been read")


def read_wall_offsets(path: str | Path) -> tuple[WallOffset, ...]:
    """Where the wall clock stood against the bench clock at the start and, if all ended well, at the end.

    Stamps of the messages are made with the first; the difference is what the wall clock was adjusted by
    meanwhile. Empty for virtual time and for recordings of version 0.1.

    Raises:
        DataError: not an MCAP file, or damaged where the offsets stand.
    """
    from mcap.records import Metadata

    kept = (r for r in _records(Path(path), []) if isinstance(r, Metadata))
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
