"""Records and messages of an MCAP file, whatever wrote it, and what is wrong with damaged ones."""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO

from hil.core.errors import DataError, reason_of
from hil.core.path_hints import meant
from hil.support.file_reading import must_be_file

COPY_AGAIN = "copy it again from where it was recorded"
_MAGIC_BYTES, _ZSTD = 8, b"\x28\xb5\x2f\xfd"
_HEAD, _NUMBER = struct.Struct("<BQ"), struct.Struct("<H")
"""Opcode and length before each record; number of the channel, with which a message begins."""


def records_of(path: Path, problems: list[str]) -> Iterator[tuple[int, Any]]:
    """Records of a file in order, a chunk counting as one, each with the byte at which it begins.

    Damage ends the iteration and is named in `problems`.

    Raises:
        DataError: the file cannot be read or is not MCAP.
    """
    try:
        must_be_file(path)
        with path.open("rb") as stream:
            size = max(1, path.stat().st_size)
            reader, at = _reader(stream, size), 0
            records = reader.records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except OSError:
                    raise
                except Exception as error:  # whatever the library makes of damaged bytes
                    if at == 0:
                        _must_be_mcap(path, stream.tell(), error)
                    problems.append(_damage(at, stream.tell(), error))
                    return
                yield max(at, reader.begin), record
                at = stream.tell()
    except OSError as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None


def _reader(stream: BinaryIO, size: int) -> Any:
    """Reader of the records of a stream that passes over indexes of messages: nobody here asks for them.

    Its `begin` is the byte at which the latest record begins.
    """
    from mcap.opcode import Opcode
    from mcap.stream_reader import StreamReader

    class Reader(StreamReader):  # type: ignore[misc]  # the library has no types
        begin = 0

        def _read_record(self, opcode: int, length: int) -> Any:
            self.begin = stream.tell() - _HEAD.size
            if opcode != Opcode.MESSAGE_INDEX:
                return super()._read_record(opcode, length)
            self._stream.read(length)
            return None

    return Reader(stream, emit_chunks=True, record_size_limit=size)


@dataclass(frozen=True)
class BagTopic:
    """Topic of a recording of ROS messages, as its file describes it.

    Attributes:
        name: name of the topic.
        kind: type of its messages, such as `sensor_msgs/msg/JointState`.
        encoding: encoding of its messages, `cdr` for those of ROS 2.
        definition_encoding: language of the definition, `ros2msg` or `ros2idl`; empty without one.
        definition: definition of the type with those of its parts.
        number: number of the channel in an MCAP file.
    """

    name: str
    kind: str
    encoding: str
    definition_encoding: str = ""
    definition: str = ""
    number: int = 0


def topic_of(channel: Any, schemas: Mapping[int, Any]) -> BagTopic:
    """Topic of a channel of an MCAP file."""
    schema = schemas.get(channel.schema_id)
    if schema is None:
        return BagTopic(channel.topic, "", channel.message_encoding, number=channel.id)
    text = schema.data.decode("utf-8", "replace")
    return BagTopic(channel.topic, schema.name, channel.message_encoding, schema.encoding, text, channel.id)


def described_in(chunk: Any) -> Iterator[Any]:
    """Schemas and channels in a chunk, whose checksum must be right; its messages are passed over."""
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Schema

    readers = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read}
    for opcode, content in _records_in(chunk):
        if (read := readers.get(opcode)) is not None:
            yield read(ReadDataStream(BytesIO(content)))


def _records_in(chunk: Any) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of every record in a chunk, whose checksum must be right."""
    from mcap.stream_reader import get_chunk_data_stream

    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data, at = memoryview(stream.read(size)), 0
    while at < size:
        opcode, length = _HEAD.unpack_from(data, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + length
        yield opcode, data[begin:at]


def messages_of(path: Path, wanted: Callable[[Any], bool], problems: list[str]) -> Iterator[tuple[Any, Any]]:
    """Channel and message of the wanted channels, by log time; those of one time as they are in the file.

    The file may have any order of chunks, and of records outside them. Where chunks overlap in time, as
    programs leave them that group messages by topic, all wanted messages are held in memory.

    Args:
        path: an MCAP file.
        wanted: function from a channel to True if its messages are wanted.
        problems: list that receives a message for each part that cannot be read.

    Raises:
        DataError: the file cannot be read or is not MCAP.
    """
    by_time = attrgetter("log_time")
    pieces = _pieces(path, wanted, problems)
    if not _in_order(path):
        pieces = iter([[pair for piece in pieces for pair in piece]])
    for piece in pieces:
        yield from sorted(piece, key=lambda pair: by_time(pair[1]))


def _pieces(
    path: Path, wanted: Callable[[Any], bool], problems: list[str]
) -> Iterator[list[tuple[Any, Any]]]:
    """Channel and message of wanted channels: those of each chunk, and each message outside chunks."""
    from mcap.records import Channel, Chunk, Message

    channels: dict[int, Any] = {}
    unknown = 0

    def takes(number: int) -> bool:
        return number not in channels or wanted(channels[number])

    for at, record in records_of(path, problems):
        try:
            parts = list(_parts_of(record, takes)) if isinstance(record, Chunk) else [record]
        except Exception as error:  # whatever unpacking makes of damaged bytes
            problems.append(f"the chunk at byte {at} is damaged ({error})")
            channels = {**_channels_outside_chunks(path), **channels}
            continue
        found = []
        for part in parts:
            if isinstance(part, Channel):
                channels[part.id] = part
            elif isinstance(part, Message):
                channel = channels.get(part.channel_id)
                unknown += channel is None
                if channel is not None and wanted(channel):
                    found.append((channel, part))
        if found:
            yield found
    if unknown:
        problems.append(f"{unknown} messages cannot be read, because nothing says of what topic they are")


def _channels_outside_chunks(path: Path) -> dict[int, Any]:
    """Channels by number that the summary of a file repeats; none where it has no summary."""
    from mcap.records import Channel

    return {record.id: record for _, record in records_of(path, []) if isinstance(record, Channel)}


def _parts_of(chunk: Any, takes: Callable[[int], bool]) -> Iterator[Any]:
    """Channels of a chunk, whose checksum must be right, and messages of the channels that are taken."""
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message

    for opcode, content in _records_in(chunk):
        if opcode == Opcode.CHANNEL:
            yield Channel.read(ReadDataStream(BytesIO(content)))
        elif opcode == Opcode.MESSAGE and takes(_NUMBER.unpack_from(content)[0]):
            yield Message.read(ReadDataStream(BytesIO(content)), len(content))


def _in_order(path: Path) -> bool:
    """Whether no chunk, and no message outside them, begins before the end of an earlier one."""
    from mcap.records import Chunk, Message

    latest_ns = 0
    for _, record in records_of(path, []):
        if isinstance(record, Chunk):
            first_ns, last_ns = record.message_start_time, record.message_end_time
        elif isinstance(record, Message):
            first_ns = last_ns = record.log_time
        else:
            continue
        if first_ns < latest_ns and last_ns:  # 0 and 0: a chunk without messages
            return False
        latest_ns = max(latest_ns, last_ns)
    return True


def in_place_of(path: Path) -> str:
    """Remedy for a wrong path: the recordings in a run's folder, else the command that takes such a path."""
    inside = sorted(path.glob("*.mcap")) if path.is_dir() else []
    return (
        "name one of " + ", ".join(map(str, inside))
        if inside
        else meant(path)
        if path.suffix != ".mcap"
        else ""
    )


def _must_be_mcap(path: Path, reached: int, error: Exception) -> None:
    """Refuse a file of another kind, given what its first record failed with."""
    from mcap.exceptions import InvalidMagic

    if reached == 0:
        raise DataError(str(path), "is empty", expected="a recording (.mcap)", remedy=COPY_AGAIN)
    with path.open("rb") as stream:
        if stream.read(len(_ZSTD)) == _ZSTD:
            raise DataError(
                str(path),
                "is packed as a whole",
                expected="a recording (.mcap)",
                remedy=f"unpack it with `zstd -d {path}`",
            )
    if isinstance(error, InvalidMagic) or reached < _MAGIC_BYTES:
        raise DataError(
            str(path), "is not an MCAP file", expected="a recording (.mcap)", remedy=in_place_of(path)
        )


def _damage(at: int, reached: int, error: Exception) -> str:
    """Description of damage after byte `at`; `reached` is the byte up to which the file was read."""
    from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded

    why = str(error)
    if isinstance(error, (EndOfFile, InvalidMagic, RecordLengthLimitExceeded, struct.error)):
        message = f"ends early at byte {reached} (writer killed, disk full, or damaged there)"
        return f"{message}: {why}" if why else message
    return f"is damaged after byte {at}: {why or type(error).__name__}"
