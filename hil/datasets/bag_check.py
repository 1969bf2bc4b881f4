"""Checks, before a bag is read, that a file of it is complete and of the right kind, and lists its topics."""

from pathlib import Path

from hil.core.errors import DataError, HilError, reason_of
from hil.recording.mcap_scan import COPY_AGAIN, BagTopic, described_in, records_of, topic_of
from hil.support.file_reading import must_be_file

_MCAP, _SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
_KINDS = ((_SQLITE, "an SQLite database"), (b"#ROSBAG", "a ROS 1 bag"), (b"\x1f\x8b", "packed by gzip"))
CONVERT = "convert it to a rosbag2 recording, with the messages of ROS 2 as CDR"


def check_bag(file: Path) -> list[BagTopic]:
    """Check a storage file of a bag; the topics of an MCAP file, none of another one.

    Raises:
        DataError: the file cannot be read, is damaged or of another kind.
    """
    try:
        must_be_file(file)
        with file.open("rb") as stream:
            head = stream.read(len(_SQLITE))
    except OSError as error:
        raise DataError(str(file), f"cannot be read ({reason_of(error)})") from None
    if head.startswith(_MCAP):
        return _check_mcap(file)
    if file.suffix == ".mcap":
        raise DataError(str(file), f"is not an MCAP file: it is {_kind(head)}", remedy=_for_kind(head))
    return []  # a database is left to its reader


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


def _check_mcap(path: Path) -> list[BagTopic]:
    """Read all records, and check the chunks' checksums."""
    from mcap.records import Channel, Chunk, Schema

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    problems: list[str] = []
    try:
        for _, record in records_of(path, problems):
            for part in described_in(record) if isinstance(record, Chunk) else (record,):
                if isinstance(part, Schema):
                    schemas[part.id] = part
                elif isinstance(part, Channel):
                    channels[part.id] = part
    except HilError:
        raise
    except Exception as error:  # the library may raise anything on a damaged chunk
        problems.append(str(error) or type(error).__name__)
    if problems:
        why = f"is not a readable rosbag2 recording (it {problems[0]})"
        raise DataError(str(path), why, remedy="repair it with `mcap recover`")
    return [topic_of(channel, schemas) for channel in channels.values()]
