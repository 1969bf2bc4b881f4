"""Unpacks what is compressed in recordings, never to more than a recording can sensibly hold.

A few kilobytes can unpack to gigabytes. Here one piece gives at most `MOST_BYTES`, and all pieces of a
file together at most `FACTOR` times what is stored, or `FREE_BYTES` where that is more.
"""

from __future__ import annotations

import gzip
import io
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from hil.vocabulary.errors import DataError, reason_of
from hil.vocabulary.reading import read_bytes

MOST_BYTES = 256 << 20
FREE_BYTES = 64 << 20
FACTOR = 200
PACKED = (".zstd", ".zst")
"""Endings of files that zstd packs as a whole."""
_MOST_STORED = 1 << 30
_PIECE = 1 << 20
_REMEDY = "a recording does not unpack to that much; record it anew, or split it"


class Allowance:
    """How much a file may still unpack to.

    Args:
        path: of the file, for messages.
        stored: its size in bytes.
    """

    def __init__(self, path: Path, stored: int) -> None:
        self._path = path
        self._most = self._left = max(FREE_BYTES, FACTOR * stored)

    def take(self, size: int) -> None:
        """Count a piece that is about to be unpacked.

        Raises:
            DataError: the file unpacks to more than it may.
        """
        self._left -= size
        if self._left < 0:
            raise DataError(str(self._path), f"unpacks to more than {self._most >> 20} MiB", remedy=_REMEDY)


def read_packed(path: Path) -> bytes:
    """Content of a plain or gzip file (by its name).

    Raises:
        DataError: it is missing, damaged or too large.
    """
    try:
        raw = read_bytes(path, _MOST_STORED)
        if path.suffix != ".gz":
            return raw
        most = min(max(FREE_BYTES, FACTOR * len(raw)), _MOST_STORED)
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as stream:
            data = stream.read(most + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(
            str(path), f"damaged gzip ({error})", expected="a whole file", remedy="copy it again"
        ) from None
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None
    if len(data) > most:
        raise DataError(str(path), f"unpacks to more than {most >> 20} MiB", remedy=_REMEDY)
    return data


def chunk_data(chunk: Any, allowance: Allowance) -> bytes:
    """Records of an MCAP chunk, its size and checksum held against what it says.

    Raises:
        ValueError: damaged, larger than any chunk, or not as long as it says.
        DataError: the file unpacks to more than it may.
    """
    said = int(chunk.uncompressed_size)
    if said > MOST_BYTES:
        raise ValueError(f"a chunk of {said >> 20} MiB, more than {MOST_BYTES >> 20}")
    allowance.take(said)
    data = _unpacked(chunk.compression, chunk.data, said)
    if len(data) != said:
        raise ValueError(f"a chunk that is not {said} bytes long, as it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk with a wrong checksum")
    return data


def _unpacked(compression: str, data: bytes, said: int) -> bytes:
    """At most one byte more than `said`."""
    if compression == "":
        return data
    if compression == "zstd":
        import zstandard

        try:
            with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
                return bytes(stream.read(said + 1))
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        unpacker = LZ4FrameDecompressor()
        try:
            found: bytes = unpacker.decompress(data, max_length=said + 1)
        except (RuntimeError, EOFError) as error:
            raise ValueError(str(error)) from None
        return found + bytes(unpacker.unused_data or b"")
    raise ValueError(f"a chunk packed by {compression!r}, which is unknown")


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """A file, or a folder, as it is; one packed as a whole by zstd (by its name) unpacked, for as long.

    Raises:
        DataError: damaged, or it unpacks to more than it may.
    """
    if path.is_dir() or path.suffix not in PACKED:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        try:
            with path.open("rb") as source, plain.open("wb") as target:
                unpack_stream(source, target, Allowance(path, path.stat().st_size))
        except ValueError as error:
            raise DataError(
                str(path),
                f"cannot be unpacked ({error})",
                expected="a whole file packed by zstd",
                remedy="copy it again",
            ) from None
        except OSError as error:
            raise DataError(str(path), f"cannot be unpacked ({reason_of(error)})") from None
        yield plain


def unpack_stream(source: BinaryIO, target: BinaryIO, allowance: Allowance) -> None:
    """Write a zstd stream unpacked.

    Raises:
        ValueError: damaged.
        DataError: it unpacks to more than it may.
    """
    import zstandard

    try:
        with zstandard.ZstdDecompressor().stream_reader(
            source, read_across_frames=True, closefd=False
        ) as reader:
            while piece := reader.read(_PIECE):
                allowance.take(len(piece))
                target.write(piece)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from None
