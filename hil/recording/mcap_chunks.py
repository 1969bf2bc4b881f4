"""Writes an MCAP file in chunks, message by message with few calls, byte for byte as the library mcap does.

The library builds every message from a dozen small writes, which take longer than all else of a recording.
Here a message is two: its head and its data. All other records are made by the library's classes
(`mcap.records`). Format: https://mcap.dev/spec.
"""

import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from struct import Struct, pack
from typing import Any, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

Message = tuple[str, int, bytes]
"""Topic, time of measurement (bench clock, ns), data."""

_HEAD = Struct("<BQHIQQ")
"""Opcode and length of a message record, then channel, sequence number, log time, time of publication."""
_BEHIND_LENGTH = _HEAD.size - 9
_INDEX = Struct("<BQHI")
_MAX_SEQUENCE = 0xFFFFFFFF


class Output(Protocol):
    """What the file is written to."""

    def write(self, data: bytes) -> int:
        """Write all of `data`."""

    def tell(self) -> int:
        """Bytes written so far."""


class _Topic:
    """A topic's number, the number of its messages, and log time and offset of those in the chunk."""

    __slots__ = ("index", "number", "sent")

    def __init__(self, number: int) -> None:
        self.number, self.sent = number, 0
        self.index: list[int] = []


class ChunkedFile:
    """An MCAP file for ROS 2 whose log times never decrease; a chunk ends where `flush` is called.

    Args:
        output: file to write to; a failed write raises `OSError`.
        library: name of the writing program, for the head of the file.
        offset_ns: log time at the bench clock's zero.
    """

    def __init__(self, output: Output, library: str, offset_ns: int = 0) -> None:
        self._output, self._offset_ns = output, offset_ns
        self._topics: dict[str, _Topic] = {}
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunk = bytearray()
        self._in_chunk: list[_Topic] = []
        self._sent: dict[_Topic, None] = {}
        output.write(MCAP0_MAGIC + _record(Header("ros2", library)))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts."""
        at, record = self._output.tell(), _record(Metadata(name, dict(values)))
        self._metadata.append(MetadataIndex(at, len(record), name))
        self._output.write(record)

    def add_schema(self, name: str, definition: str) -> int:
        """Describe a message type of ROS 2; returns its number."""
        self._schemas.append(Schema(len(self._schemas) + 1, definition.encode(), "ros2msg", name))
        self._chunk += _record(self._schemas[-1])
        return len(self._schemas)

    def add_topic(self, topic: str, schema: int, about: Mapping[str, str]) -> None:
        """Describe a topic of a schema's type, with metadata."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, "cdr", dict(about), schema))
        self._chunk += _record(self._channels[-1])
        self._topics[topic] = _Topic(number)

    def add(self, log_ns: int, messages: Iterable[Message]) -> None:
        """Add messages, all logged at one time; none counts as published after it."""
        topics, chunk, offset_ns, in_chunk = self._topics, self._chunk, self._offset_ns, self._in_chunk
        for name, t_ns, data in messages:
            topic, at, t_ns = topics[name], len(chunk), t_ns + offset_ns
            published_ns = log_ns if t_ns > log_ns else t_ns if t_ns > 0 else 0
            sent = topic.sent
            length = _BEHIND_LENGTH + len(data)
            chunk += _HEAD.pack(
                Opcode.MESSAGE, length, topic.number, sent & _MAX_SEQUENCE, log_ns, published_ns
            )
            chunk += data
            if not topic.index:
                in_chunk.append(topic)
            topic.index += (log_ns, at)
            topic.sent = sent + 1

    def flush(self) -> None:
        """Write the chunk in progress, unless it has no message."""
        if not self._in_chunk:
            return
        data = bytes(self._chunk)
        times = [t_ns for topic in self._in_chunk for t_ns in (topic.index[0], topic.index[-2])]
        packed = zstandard.compress(data)
        chunk = Chunk("zstd", packed, max(times), min(times), zlib.crc32(data), len(data))
        at, record = self._output.tell(), _record(chunk)
        self._output.write(record)
        index, offsets, index_at = b"", dict[int, int](), self._output.tell()
        for topic in self._in_chunk:
            entries = topic.index
            offsets[topic.number] = index_at + len(index)
            size = 8 * len(entries)
            index += _INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, topic.number, size)
            index += pack(f"<{len(entries)}Q", *entries)
        self._output.write(index)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=at,
                compression=chunk.compression,
                compressed_size=len(packed),
                message_end_time=chunk.message_end_time,
                message_index_length=len(index),
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=len(data),
            )
        )
        self._chunk.clear()
        for topic in self._in_chunk:
            topic.index = []
        self._sent.update(dict.fromkeys(self._in_chunk))
        self._in_chunk = []

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.flush()
        self._output.write(_record(DataEnd(0)))
        start, summary, groups = self._output.tell(), b"", list[SummaryOffset]()
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            group = b"".join(map(_record, records))
            groups.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offsets_at = start + len(summary)
        summary += b"".join(map(_record, groups))
        footer = _record(Footer(start, offsets_at, 0))
        crc = zlib.crc32(summary + footer[:-4])
        self._output.write(summary + _record(Footer(start, offsets_at, crc)) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        counts = {topic.number: topic.sent for topic in self._sent}
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=defaultdict(int, counts),
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _record(record: Any) -> bytes:
    """The bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data
