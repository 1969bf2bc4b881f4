"""Messages of a rosbag2 recording, from its storage files: MCAP of any writer, or SQLite.

The storage files are read, and of `metadata.yaml` only their names. rosbags, which can read whole bags, gives
no message of a topic whose quality of service is another one in `metadata.yaml`, nor of a channel that the
summary of an MCAP file does not repeat. it decodes the messages, each type by the definition in its file.
"""

import heapq
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

from hil.core.errors import DataError, HilError
from hil.datasets.bag_check import CONVERT, check_bag
from hil.datasets.unpacking import PACKED, unpacked
from hil.recording.mcap_scan import BagTopic, messages_of

STORAGES = (".mcap", ".db3")
"""Suffixes of storage files."""
CDR = "cdr"
_METADATA = "metadata.yaml"
_IDL_LINE = "=" * 80 + "\n"
_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that rosbag2 has compressed: those of CDR are others."""
_LONGEST_REASON = 200
_REPAIR = {".mcap": CONVERT, ".db3": "repair it with `sqlite3 FILE .recover`"}
_REINDEX = "write its metadata.yaml afresh with `ros2 bag reindex`"

Found = tuple[BagTopic, int, bytes]
"""Topic of a message, its log time in ns, and the message as it is encoded."""


def storage_suffix(path: Path) -> str:
    """Suffix of a storage file, without the suffix of its compression."""
    return Path(path.stem).suffix if path.suffix in PACKED else path.suffix


def storage_files(bag: Path) -> list[Path]:
    """Storage files of a bag: the path itself if it is a file, else those that its metadata names.

    Raises:
        DataError: a file that the metadata names is not there.
    """
    if bag.is_file():
        return [bag]
    named = [bag / name for name in _named_in(bag / _METADATA)]
    if missing := [file.name for file in named if not file.exists()]:
        raise DataError(
            str(bag),
            f"lacks {', '.join(missing)}, which its {_METADATA} names",
            expected="all of its files",
            remedy=f"copy them, too, or {_REINDEX}",
        )
    return named or sorted(f for f in bag.iterdir() if f.is_file() and storage_suffix(f) in STORAGES)


def _named_in(metadata: Path) -> list[str]:
    """File names in the metadata of a bag; none where it cannot be read."""
    from ruamel.yaml import YAML

    try:
        paths = YAML(typ="safe").load(metadata)["rosbag2_bagfile_information"]["relative_file_paths"]
        return [Path(path).name for path in paths]
    except Exception:  # a damaged file may hold anything, and the storage files do not need it
        return []


@dataclass(frozen=True)
class OpenedBag:
    """A bag whose messages can be read.

    Attributes:
        path: folder or file, as it was given.
        files: storage files, unpacked.
        topics: topics of each storage file.
    """

    path: Path
    files: tuple[Path, ...]
    topics: tuple[tuple[BagTopic, ...], ...]

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[BagTopic, int, Any]]:
        """Topic, log time (ns) and decoded message of the wanted topics, by log time.

        Args:
            wanted: names of topics; None for all, without messages that cannot be decoded.

        Raises:
            DataError: a message cannot be read.
        """
        with _readable(self.path):
            parts = [
                _stored(file, topics, wanted) for file, topics in zip(self.files, self.topics, strict=True)
            ]
            for topic, log_ns, raw in heapq.merge(*parts, key=itemgetter(1)):
                try:
                    message = decoded(topic, raw)
                except Exception:  # whatever a definition or bytes of another program lead to
                    if wanted is not None:
                        raise
                    continue
                yield topic, log_ns, message


@contextmanager
def opened_bag(path: Path) -> Iterator[OpenedBag]:
    """Open a bag: a rosbag2 folder, or one of its storage files.

    Raises:
        DataError: a file is missing, damaged or of another kind.
    """
    with ExitStack() as stack:
        files = tuple(stack.enter_context(unpacked(file)) for file in storage_files(path))
        with _readable(path):
            topics = tuple(tuple(check_bag(file) or _topics_of_sqlite(file)) for file in files)
        yield OpenedBag(path, files, topics)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turns what libraries raise on foreign files into `DataError`."""
    try:
        yield
    except HilError:
        raise
    except Exception as error:  # a library that reads foreign files may raise anything
        why = " ".join(str(error).split())[:_LONGEST_REASON]
        raise DataError(
            str(path),
            f"is not a readable rosbag2 recording ({why or type(error).__name__})",
            remedy=_REPAIR.get(path.suffix, _REINDEX),
        ) from None


def _topics_of_sqlite(file: Path) -> list[BagTopic]:
    from rosbags.rosbag2 import Reader

    with Reader(file) as reader:
        return [_topic_of(connection) for connection in reader.connections]


def _topic_of(connection: Any) -> BagTopic:
    """Topic of a connection of rosbags; the formats of its definitions begin as their encodings in MCAP."""
    definition = connection.msgdef
    encoding = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(definition.format.name, "")
    return BagTopic(
        connection.topic, connection.msgtype, connection.ext.serialization_format, encoding, definition.data
    )


def _stored(file: Path, topics: Collection[BagTopic], wanted: Collection[str] | None) -> Iterator[Found]:
    """Encoded messages of the wanted topics of one storage file, by log time."""
    if file.suffix == ".mcap":
        described = {topic.number: topic for topic in topics if wanted is None or topic.name in wanted}
        problems: list[str] = []
        for channel, message in messages_of(file, lambda c: c.id in described, problems):
            yield described[channel.id], message.log_time, message.data
        if problems:
            raise DataError(str(file), "; ".join(problems), remedy=CONVERT)
        return
    from rosbags.rosbag2 import Reader

    with Reader(file) as reader:
        chosen = [c for c in reader.connections if wanted is None or c.topic in wanted]
        if chosen:
            for connection, log_ns, raw in reader.messages(connections=chosen):
                yield _topic_of(connection), log_ns, raw


def decoded(topic: BagTopic, raw: bytes) -> Any:
    """The message that CDR bytes of a topic hold, also if compressed one by one."""
    if raw[: len(_ZSTD)] == _ZSTD:
        import zstandard

        raw = zstandard.ZstdDecompressor().decompressobj().decompress(raw)
    return _store(topic.kind, topic.definition_encoding, topic.definition).deserialize_cdr(raw, topic.kind)


@cache
def _store(kind: str, encoding: str, definition: str) -> Any:
    """Type store for one message type: by its definition, else as ROS 2 Humble defines it."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not definition:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    if encoding == "ros2msg":
        store.register(get_types_from_msg(definition, kind))
        return store
    parts = definition.split(_IDL_LINE)[1:] if definition.startswith(_IDL_LINE) else [f"\n{definition}"]
    for part in parts:  # each begins with a line that names its file
        store.register(get_types_from_idl(part.partition("\n")[2]))
    return store
