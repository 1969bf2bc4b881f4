"""Records of an MCAP file one after the other, whatever wrote it, and what is wrong with damaged ones."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.core.errors import DataError, reason_of
from hil.core.wrong_path_hint import meant
from hil.support.file_reading import must_be_file

COPY_AGAIN = "copy it again from where it was recorded"
_MAGIC_BYTES, _ZSTD = 8, b"\x28\xb5\x2f\xfd"


def records_of(path: Path, problems: list[str]) -> Iterator[tuple[int, Any]]:
    """Records of a file in order, a chunk counting as one, each with the byte at which it begins.

    Damage ends the iteration and is named in `problems`.

    Raises:
        DataError: the file cannot be read or is not MCAP.
    """
    from mcap.stream_reader import StreamReader

    try:
        must_be_file(path)
        with path.open("rb") as stream:
            size = max(1, path.stat().st_size)
            records, at = StreamReader(stream, emit_chunks=True, record_size_limit=size).records, 0
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
                yield at, record
                at = stream.tell()
    except OSError as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None


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


def ends_early(error: Exception) -> bool:
    """Whether reading failed because a file has fewer bytes than its records say."""
    from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded

    return isinstance(error, (EndOfFile, InvalidMagic, RecordLengthLimitExceeded, struct.error))


def _damage(at: int, reached: int, error: Exception) -> str:
    """Description of damage after byte `at`; `reached` is the byte up to which the file was read."""
    why = str(error)
    if ends_early(error):
        message = f"ends early at byte {reached} (writer killed, disk full, or damaged there)"
        return f"{message}: {why}" if why else message
    return f"is damaged after byte {at}: {why or type(error).__name__}"
