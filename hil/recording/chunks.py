"""An MCAP file chunk by chunk: messages are put together here, every other record is `mcap`'s own.

`mcap.writer.Writer` takes some fifty Python calls for a message, and a control cycle has thirteen of them.
Here a message is one call: its head has a fixed layout, and its place in the chunk follows from the lengths
before it. A chunk is packed, checked and indexed when it is closed (docs/decisions/0030).

Format: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Protocol

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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode and length of a message record, channel, sequence number, log time, publish time."""
_INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode and length of a message index, channel, bytes of its entries."""
_FOOTER_HEAD = struct.Struct("<BQQQ")
_MESSAGE = int(Opcode.MESSAGE)
_INSIDE = _MESSAGE_HEAD.size - _RECORD_HEAD.size
_MOST_U32 = 0xFFFFFFFF


class Stream(Protocol):
    """Where a file goes."""

    def write(self, data: bytes) -> object:
        """Take all of `data`, or raise `OSError`."""

    def tell(self) -> int:
        """Bytes taken so far."""


class Topic:
    """A channel of the file.

    Attributes:
        number: of the channel.
        sent: messages so far; the next one's sequence number.
        index: log time and place of each message in the open chunk, in turn.
    """

    __slots__ = ("index", "number", "sent")

    def __init__(self, number: int) -> None:
        self.number, self.sent = number, 0
        self.index: list[int] = []


class ChunkedFile:
    """Writes an MCAP file; whoever flushes it decides how long its chunks are.

    Args:
        stream: where it goes.
        profile, library: for its header.
    """

    def __init__(self, stream: Stream, *, profile: str, library: str) -> None:
        self._stream = stream
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._topics: list[Topic] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._open: list[bytes] = []
        self._length = 0
        self._pack = zstandard.ZstdCompressor()
        stream.write(MCAP0_MAGIC + _bytes_of(Header(profile, library)))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts, between two chunks."""
        data, at = _bytes_of(Metadata(name=name, metadata=dict(values))), self._stream.tell()
        self._stream.write(data)
        self._metadata.append(MetadataIndex(offset=at, length=len(data), name=name))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Describe a type of messages; its number."""
        number = len(self._schemas) + 1
        self._schemas.append(Schema(id=number, name=name, encoding=encoding, data=data))
        self._put(_bytes_of(self._schemas[-1]))
        return number

    def add_topic(self, name: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> Topic:
        """Open a channel for messages of one type."""
        channel = Channel(
            id=len(self._channels) + 1, topic=name, message_encoding=encoding, schema_id=schema,
            metadata=dict(metadata),
        )  # fmt: skip
        self._channels.append(channel)
        self._topics.append(Topic(channel.id))
        self._put(_bytes_of(channel))
        return self._topics[-1]

    def _put(self, record: bytes) -> None:
        self._open.append(record)
        self._length += len(record)

    def add(self, topic: Topic, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add one message to the open chunk.

        Raises:
            struct.error: a time is negative.
        """
        size = _INSIDE + len(data)
        number = topic.sent & _MOST_U32
        self._open += (_MESSAGE_HEAD.pack(_MESSAGE, size, topic.number, number, log_ns, publish_ns), data)
        topic.index += (log_ns, self._length)
        topic.sent += 1
        self._length += _RECORD_HEAD.size + size

    def flush(self) -> None:
        """Close the open chunk, if it has messages, and hand it over with its indexes."""
        touched = sorted((topic for topic in self._topics if topic.index), key=lambda topic: topic.index[1])
        if not touched:
            return
        plain = b"".join(self._open)
        chunk = Chunk(
            compression="zstd",
            data=self._pack.compress(plain),
            message_start_time=min(min(topic.index[::2]) for topic in touched),
            message_end_time=max(max(topic.index[::2]) for topic in touched),
            uncompressed_crc=zlib.crc32(plain),
            uncompressed_size=len(plain),
        )
        written, begin = _bytes_of(chunk), self._stream.tell()
        self._stream.write(written)
        places, indexes = _indexes(touched, begin + len(written))
        self._stream.write(indexes)
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=begin,
                chunk_length=len(written),
                message_index_offsets=places,
                message_index_length=len(indexes),
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for topic in touched:
            topic.index = []
        self._open, self._length = [], 0

    def finish(self) -> None:
        """Write what waits, the summary and the end; the stream stays open."""
        self.flush()
        self._stream.write(_bytes_of(DataEnd(data_section_crc=0)))
        start = self._stream.tell()
        summary, offsets = b"", b""
        groups: dict[Opcode, Iterable[McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.METADATA_INDEX: self._metadata,
        }
        for opcode, records in groups.items():
            group = b"".join(map(_bytes_of, records))
            at = SummaryOffset(
                group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
            )  # fmt: skip
            summary, offsets = summary + group, offsets + _bytes_of(at)
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
        footer.summary_crc = zlib.crc32(summary + offsets + head)
        self._stream.write(summary + offsets + _bytes_of(footer) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        """Counts of the whole file."""
        counts = {topic.number: topic.sent for topic in self._topics if topic.sent}
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((one.message_start_time for one in self._chunks), default=0),
            message_end_time=max((one.message_end_time for one in self._chunks), default=0),
            schema_count=len(self._schemas),
        )


def _indexes(topics: Iterable[Topic], begin: int) -> tuple[dict[int, int], bytes]:
    """Message indexes of a chunk that begin at a place in the file: each channel's place, and their bytes."""
    places, out = {}, b""
    for topic in topics:
        entries = struct.pack(f"<{len(topic.index)}Q", *topic.index)
        places[topic.number] = begin + len(out)
        out += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), topic.number, len(entries)) + entries
    return places, out


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
