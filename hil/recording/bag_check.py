"""Looks through a bag before a library opens it that unpacks whatever it is given.

Every compressed piece is unpacked once and let go of, within the bounds of `hil.recording.unpacking`, and
the index has to name exactly the chunks that were looked at.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from hil.recording.mcap_reader import top_level
from hil.recording.unpacking import Allowance, chunk_data, unpack_stream
from hil.vocabulary.errors import DataError, reason_of
from hil.vocabulary.reading import must_be_file

_MCAP, _SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
_METADATA = "metadata.yaml"
_MOST_METADATA_BYTES = 4 << 20


def check_bag(path: Path) -> None:
    """Look through a `.mcap` file or a rosbag2 folder.

    Raises:
        DataError: it cannot be read, is damaged, or unpacks to more than a recording does.
    """
    try:
        for file in _files(path):
            must_be_file(file)
            with file.open("rb") as stream:
                _check(file, stream)
    except OSError as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None


def _files(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        yield path
        return
    for file in sorted(file for file in path.iterdir() if file.is_file()):
        if file.name != _METADATA:
            yield file
        elif file.stat().st_size > _MOST_METADATA_BYTES:
            raise DataError(str(file), f"is larger than {_MOST_METADATA_BYTES >> 20} MiB")


def _check(path: Path, stream: BinaryIO) -> None:
    """Look through one file: MCAP, SQLite (nothing to unpack in it), or either packed as a whole."""
    size = path.stat().st_size
    head = stream.read(len(_SQLITE))
    stream.seek(0)
    if head.startswith(_MCAP):
        _check_mcap(path, stream, size)
    elif head != _SQLITE:
        with tempfile.TemporaryFile() as plain:
            try:
                unpack_stream(stream, plain, Allowance(path, size))
            except DataError:
                raise
            except ValueError:
                return
            plain.seek(0)
            if plain.read(len(_MCAP)) == _MCAP:
                size = plain.seek(0, 2)
                plain.seek(0)
                _check_mcap(path, plain, size)


def _check_mcap(path: Path, stream: BinaryIO, size: int) -> None:
    from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
    from mcap.records import Chunk, ChunkIndex, Footer

    allowance = Allowance(path, size)
    starts: set[int] = set()
    chunks: dict[int, tuple[Any, ...]] = {}
    try:
        for at, record in top_level(stream, size):
            starts.add(at)
            if isinstance(record, Chunk):
                chunk_data(record, allowance)
                chunks[at] = (record.compression, len(record.data), record.uncompressed_size)
            elif isinstance(record, ChunkIndex):
                said = (record.compression, record.compressed_size, record.uncompressed_size)
                if chunks.get(record.chunk_start_offset) != said:
                    raise ValueError(
                        f"its index names a chunk at {record.chunk_start_offset} that is not there"
                    )
            elif isinstance(record, Footer) and record.summary_start not in starts | {0}:
                raise ValueError("its index does not begin where it says")
    except DataError:
        raise
    except (McapError, ValueError, EOFError, MemoryError, struct.error) as error:
        cut = isinstance(error, (EndOfFile, RecordLengthLimitExceeded, struct.error))
        why = f"it ends at byte {size}, within a record" if cut else str(error) or type(error).__name__
        raise DataError(
            str(path), f"is not a readable rosbag2 recording ({why})",
            remedy="repair it with `mcap recover`",
        ) from None  # fmt: skip
