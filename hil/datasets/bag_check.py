"""Checks, before a bag is read, that the file is complete and of the right kind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from hil.core.errors import DataError, reason_of
from hil.recording.mcap_records import COPY_AGAIN, ends_early
from hil.support.file_reading import must_be_file

_MCAP, _SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
_METADATA = "metadata.yaml"
_MOST_METADATA_BYTES = 4 << 20
_PROFILE, _ENCODINGS = "ros2", ("ros2msg", "ros2idl", "omgidl", "")
_KINDS = ((_SQLITE, "an SQLite database"), (b"#ROSBAG", "a ROS 1 bag"), (b"\x1f\x8b", "packed by gzip"))
CONVERT = "convert it to a rosbag2 recording, with the messages of ROS 2 as CDR"


def check_bag(path: Path) -> None:
    """Check a `.mcap` file, or all files of a rosbag2 folder.

    Raises:
        DataError: a file cannot be read, is damaged or of another kind.
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
    """Check one file; SQLite and compressed files are left to their readers."""
    size = path.stat().st_size
    head = stream.read(len(_SQLITE))
    stream.seek(0)
    if head.startswith(_MCAP):
        _check_mcap(path, stream, size)
    elif path.suffix == ".mcap":
        raise DataError(str(path), f"is not an MCAP file: it is {_kind(head)}", remedy=_for_kind(head))


def _kind(head: bytes) -> str:
    """Description of a file's kind by its first bytes, for a message."""
    known = next((kind for magic, kind in _KINDS if head.startswith(magic)), "")
    if known or not head:
        return known or "empty"
    return "text" if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head) else "of an unknown kind"


def _for_kind(head: bytes) -> str:
    """Remedy for a file of this kind."""
    if head == _SQLITE:
        return "give it a name that ends with .db3"
    if head.startswith(b"#ROSBAG"):
        return "convert it with `rosbags-convert`"
    return CONVERT if head else COPY_AGAIN


def _check_origin(path: Path, profile: str, indexed: BinaryIO | None) -> None:
    """Raise `DataError` for a sound MCAP file that was not written by rosbag2."""
    from mcap.reader import make_reader

    encodings: set[str] = set()
    strange = profile != _PROFILE
    if indexed is not None:
        indexed.seek(0)
        summary = make_reader(indexed).get_summary()
        if summary is not None:
            schemas = {schema.encoding for schema in summary.schemas.values()}
            strange |= not schemas <= set(_ENCODINGS)
            encodings = schemas | {channel.message_encoding for channel in summary.channels.values()}
    if strange:
        held = ", ".join(sorted(encodings - {""}))
        raise DataError(
            str(path),
            f"is an MCAP file, but no rosbag2 recording (profile {profile!r}, "
            f"{f'encoded as {held}' if held else 'without an index'})",
            expected=f"profile {_PROFILE!r}, messages encoded as cdr",
            remedy=CONVERT,
        )


def _check_mcap(path: Path, stream: BinaryIO, size: int) -> None:
    from mcap.records import Chunk, Footer, Header
    from mcap.stream_reader import StreamReader, get_chunk_data_stream

    profile, indexed = "", False
    try:
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=size).records:
            if isinstance(record, Chunk):
                get_chunk_data_stream(record, validate_crc=True)
            elif isinstance(record, Header):
                profile = record.profile
            elif isinstance(record, Footer):
                indexed = record.summary_start > 0
        _check_origin(path, profile, stream if indexed else None)
    except DataError:
        raise
    except Exception as error:  # the library may raise anything on damaged bytes
        cut = f"it ends at byte {size}, within a record"
        why = cut if ends_early(error) else str(error) or type(error).__name__
        raise DataError(
            str(path), f"is not a readable rosbag2 recording ({why})", remedy="repair it with `mcap recover`"
        ) from None
