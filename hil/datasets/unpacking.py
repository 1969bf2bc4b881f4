"""Unpacks tables and bags that are packed as a whole, by gzip or zstd."""

from __future__ import annotations

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
"""Endings of files that zstd packs as a whole."""
_MOST_BYTES = 1 << 30


def read_packed(path: Path) -> bytes:
    """Content of a plain or gzip file (by its name).

    Raises:
        DataError: it is missing, damaged or too large.
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
    """A file, or a folder, as it is; one packed as a whole by zstd (by its name) unpacked, for as long.

    Raises:
        DataError: damaged.
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
