"""Decompresses tables and bags that are compressed as a whole, by gzip or zstd."""

import gzip
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil.core.errors import DataError, reason_of
from hil.support.file_reading import read_bytes

PACKED = (".zstd", ".zst")
"""Suffixes of files compressed as a whole by zstd."""
_MOST_BYTES = 1 << 30


def read_packed(path: Path) -> bytes:
    """Content of a plain or gzip file, by its suffix.

    Raises:
        DataError: the file is missing, damaged or too large.
    """
    try:
        raw = read_bytes(path, _MOST_BYTES)
        return gzip.decompress(raw) if path.suffix == ".gz" else raw
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(
            str(path), f"damaged gzip ({error})", expected="a whole file", remedy="copy it again"
        ) from None
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """The path itself; for a zstd file (by its suffix) a decompressed copy, removed on exit.

    Raises:
        DataError: the file is damaged or cannot be read.
    """
    if path.is_dir() or path.suffix not in PACKED:
        yield path
        return
    import zstandard

    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        try:
            with path.open("rb") as source, plain.open("wb") as target:
                packed = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
                shutil.copyfileobj(packed, target)
        except zstandard.ZstdError as error:
            raise DataError(
                str(path),
                f"cannot be unpacked ({error})",
                expected="a whole file packed by zstd",
                remedy="copy it again",
            ) from None
        except OSError as error:
            raise DataError(str(path), f"cannot be unpacked ({reason_of(error)})") from None
        yield plain
