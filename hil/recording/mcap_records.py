"""Records of an MCAP file one after the other, whatever wrote it, and what is wrong with damaged ones."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from hil.vocabulary.errors import DataError, reason_of
from hil.vocabulary.mistaken import meant
from hil.vocabulary.reading import must_be_file

RECORD = struct.Struct("<BQ")
"""What every record begins with: its kind, and how many bytes follow."""
COPY_AGAIN = "copy it again from where it was recorded"
_MAGIC_BYTES, _ZSTD = 8, b"\x28\xb5\x2f\xfd"


def top_level(stream: BinaryIO, limit: int) -> Iterator[tuple[int, Any]]:
    """Top-level records, in their order, with the byte at which each begins.

    Header, channels, messages outside of chunks, chunks and their indices, metadata and footer are parsed,
    None stands for every other: nine of ten are message indices, which no pass from the beginning needs.

    Args:
        stream: the file.
        limit: most bytes of a record.

    Raises:
        McapError, ValueError, struct.error: damaged.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
    from mcap.opcode import Opcode
    from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, Message, Metadata
    from mcap.stream_reader import read_magic

    wanted: dict[int, Any] = {
        Opcode.CHUNK: Chunk,
        Opcode.CHUNK_INDEX: ChunkIndex,
        Opcode.METADATA: Metadata,
        Opcode.FOOTER: Footer,
        Opcode.HEADER: Header,
        Opcode.CHANNEL: Channel,
        Opcode.MESSAGE: Message,
    }
    source = ReadDataStream(stream)
    read_magic(source)
    opcode = None
    while opcode != Opcode.FOOTER:
        at = source.count
        opcode, length = RECORD.unpack(source.read(RECORD.size))
        if length > limit:
            if opcode not in iter(Opcode):
                raise ValueError(f"what begins at byte {at} is no record")
            raise RecordLengthLimitExceeded(opcode, length, limit)
        data, kind = source.read(length), wanted.get(opcode)
        if len(data) < length:
            raise EndOfFile
        try:
            inside = ReadDataStream(io.BytesIO(data))
            if kind is None:
                yield at, None
            else:
                yield at, Message.read(inside, length) if kind is Message else kind.read(inside)
        except (EndOfFile, UnicodeDecodeError, OverflowError, struct.error):
            raise ValueError(f"the record at byte {at} does not hold what it says") from None
    read_magic(source)


def records_of(path: Path, problems: list[str]) -> Iterator[tuple[int, Any]]:
    """What `top_level` gives; damage ends the iteration and is named in `problems`.

    Raises:
        DataError: not there or not MCAP.
    """
    from mcap.exceptions import McapError

    try:
        must_be_file(path)
        with path.open("rb") as stream:
            records, at = top_level(stream, max(1, path.stat().st_size)), 0
            while True:
                try:
                    at, record = next(records)
                except StopIteration:
                    return
                except (McapError, ValueError, EOFError, MemoryError, struct.error) as error:
                    _must_be_mcap(path, stream.tell(), error if at == 0 else None)
                    problems.append(_damage(at, stream.tell(), error))
                    return
                yield at, record
    except OSError as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None


def in_place_of(path: Path) -> str:
    """What to name instead: the recordings of a run where its folder was given, else what the path is for."""
    inside = sorted(path.glob("*.mcap")) if path.is_dir() else []
    return (
        "name one of " + ", ".join(map(str, inside))
        if inside
        else meant(path)
        if path.suffix != ".mcap"
        else ""
    )


def _must_be_mcap(path: Path, reached: int, error: Exception | None) -> None:
    """Refuse a file of another kind, given what its first record failed with."""
    from mcap.exceptions import InvalidMagic

    if error is None:
        return
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
    """What is wrong behind the record at byte `at`, where reading reached a byte."""
    from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded

    if isinstance(error, (EndOfFile, InvalidMagic, RecordLengthLimitExceeded, struct.error)):
        why = f": {error}" if str(error) else ""
        return f"ends early at byte {reached} (writer killed, disk full, or damaged there){why}"
    return f"is damaged after byte {at}: {error or type(error).__name__}"
