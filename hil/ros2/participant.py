"""The bench's participant on DDS, with writers and readers of CDR bytes, and a node of its own.

For `ros2 node list` it publishes its writers and readers on `ros_discovery_info`: from this topic ROS 2
learns which node has which endpoints of DDS. Identifiers are longer in Humble than in later distributions,
and one of the wrong length is misread. So the distribution has to be known.

Importing this module loads cyclonedds and rosbags, which takes some tenths of a second.
"""

import logging
import socket
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    DDSException,
    Entity,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from hil.core.errors import UsageError
from hil.ros2.message_types import sample_type, type_store
from hil.ros2.network import Network
from hil.ros2.publishers import Publisher, handles_of, matched, publishers_of

_TOPIC = "ros_discovery_info"
_PACKAGE = "rmw_dds_common/msg/"
_ENTITIES = f"{_PACKAGE}ParticipantEntitiesInfo"
LOG = logging.getLogger(__name__)
LATCHED = ("/tf_static", "/robot_description")
"""Topics whose last message is also sent to later subscribers."""
_DEPTH, _DEPTHS = 10, {"/tf": 100}
_MOST = 10_000
"""Most writers that are examined."""
_ENCODING = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
"""Data representation of ROS 2: version 1 of CDR."""
_LONGEST_BLOCK = duration(milliseconds=1)


class NodeEntry:
    """Announces one node; DDS keeps the newest message for subscribers that come later.

    Args:
        participant: participant of Cyclone DDS.
        name: name of the node.
        distribution: distribution of ROS 2.
        quality: quality of service of a topic whose last message reaches later subscribers, too.
    """

    def __init__(self, participant: Any, name: str, distribution: str, quality: Qos) -> None:
        self._name, self._store = name, type_store(distribution)
        self._sample = sample_type(_ENTITIES, distribution)
        ((_, (_, (_, self._length))),) = self._store.fielddefs[f"{_PACKAGE}Gid"][1]
        self._participant = participant
        self._writer: Any = DataWriter(participant, Topic(participant, _TOPIC, self._sample), quality)

    def announce(self, writers: Sequence[Entity], readers: Sequence[Entity]) -> None:
        """Publish which endpoints the node has now.

        Raises:
            DDSException: it is not sent.
        """
        types = self._store.types
        node = types[f"{_PACKAGE}NodeEntitiesInfo"](
            node_namespace="/",
            node_name=self._name,
            reader_gid_seq=[self._identifier(reader) for reader in readers],
            writer_gid_seq=[self._identifier(writer) for writer in writers],
        )
        info = types[_ENTITIES](gid=self._identifier(self._participant), node_entities_info_seq=[node])
        self._writer.write(self._sample(bytes(self._store.serialize_cdr(info, _ENTITIES))))

    def _identifier(self, entity: Entity) -> Any:
        """An entity's GUID, with zeros up to the length of the distribution."""
        data = entity.get_guid().bytes.ljust(self._length, b"\0")
        return self._store.types[f"{_PACKAGE}Gid"](data=np.frombuffer(data, dtype=np.uint8))


class Reader:
    """Messages of a topic, as CDR bytes.

    A best-effort reader matches writers of either reliability.

    Args:
        participant: participant of Cyclone DDS.
        name: name of the ROS 2 topic, with a slash.
        kind: type of its messages.
        reliable: True to require reliable delivery.

    Attributes:
        entity: reader of Cyclone DDS; None once it is closed.
    """

    def __init__(self, participant: Any, name: str, kind: str, *, reliable: bool = False) -> None:
        topic = Topic(participant, f"rt{name}", sample_type(kind))
        quality = Qos(
            Policy.Reliability.Reliable(_LONGEST_BLOCK) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.Volatile,
            Policy.History.KeepLast(_DEPTH),
            _ENCODING,
        )
        self.entity: Any = DataReader(participant, topic, quality)

    def take(self) -> list[tuple[int, bytes]]:
        """Writer and bytes of the messages that have come, oldest first; never blocks. Not after `close`."""
        samples = self.entity.take(N=_DEPTH)
        return [(s.sample_info.publication_handle, s.data) for s in samples if s.sample_info.valid_data]

    def writers(self) -> list[int]:
        """Handles of the writers that the topic has now. Not after `close`."""
        return handles_of(self.entity)

    def arrival(self) -> Any:
        """Condition, for a `WaitSet`, that a message can be taken. Not after `close`."""
        return ReadCondition(self.entity, ViewState.Any | InstanceState.Any | SampleState.Any)

    def refused(self) -> int:
        """How many writers of its type do not match by their quality of service. Not after `close`."""
        return int(self.entity.get_requested_incompatible_qos_status().total_count)

    def close(self) -> None:
        """Drop the reader. Idempotent; never raises."""
        self.entity = None


class Participant:
    """One participant; its topics have the names that ROS 2 gives them.

    Args:
        network: network on which it can be found.

    Attributes:
        network: network on which it can be found.
        lost: messages that Cyclone DDS did not take.

    Raises:
        UsageError: the interface is not there, or the domain cannot be joined.
    """

    def __init__(self, network: Network) -> None:
        self.network, self.lost = network, 0
        self._writers: dict[str, tuple[Any, Any]] = {}
        self._readers: list[Reader] = []
        self._node: NodeEntry | None = None
        if network.interface and network.interface not in (
            known := [name for _, name in socket.if_nameindex()]
        ):
            raise UsageError(
                f"this computer has no network interface {network.interface!r}", expected=" or ".join(known)
            )
        try:
            self._domain = Domain(network.domain, network.configuration())
            self._participant = DomainParticipant(network.domain)
            if network.distribution is not None:
                self._node = NodeEntry(
                    self._participant, network.node, network.distribution, _quality(LATCHED[0])
                )
        except DDSException as error:
            raise UsageError(
                f"ROS 2 {network.in_words()} cannot be joined ({error.msg or error})",
                remedy="see that the interface is up, or take another domain (--ros2-domain)",
            ) from None

    def add_writer(self, name: str, kind: str, shown: str = "") -> None:
        """Create the writer of a topic, unless there is one.

        Args:
            name: name of the ROS 2 topic, with a slash.
            kind: type of its messages.
            shown: other name that it has on the network; empty for the same.
        """
        if name in self._writers:
            return
        made = sample_type(kind)
        topic = Topic(self._participant, f"rt{shown or name}", made)
        self._writers[name] = made, DataWriter(self._participant, topic, _quality(name))
        self._announce_node()

    def write(self, name: str, data: bytes) -> None:
        """Send a message as CDR; a failure is counted, and logged once. Never raises."""
        made, writer = self._writers[name]
        try:
            writer.write(made(data))
        except DDSException as error:
            if not self.lost:
                LOG.warning("ROS 2 topic %s: a message was not sent (%s); more are only counted", name, error)
            self.lost += 1

    def add_reader(self, name: str, kind: str, *, reliable: bool = False) -> Reader:
        """Create a reader of a topic.

        Args:
            name: name of the ROS 2 topic, with a slash.
            kind: type of its messages.
            reliable: True to require reliable delivery.
        """
        self._readers.append(Reader(self._participant, name, kind, reliable=reliable))
        self._announce_node()
        return self._readers[-1]

    def wait_set(self, readers: Sequence[Reader]) -> Any:
        """Wait set that triggers when a reader has a message; delete it before `close`."""
        made = WaitSet(self._participant)
        for reader in readers:
            made.attach(reader.arrival())
        return made

    def publishers(self, readers: Mapping[str, Reader]) -> Iterator[Publisher]:
        """The writers that match the readers now.

        Args:
            readers: readers by the type of their messages.
        """
        return publishers_of(self._participant, {kind: reader.entity for kind, reader in readers.items()})

    def other_types(self, name: str, kinds: Sequence[str]) -> list[str]:
        """Types, as DDS names them, with which others write a topic.

        Args:
            name: name of the ROS 2 topic, with a slash.
            kinds: types of messages that are left out.
        """
        known = {sample_type(kind).__idl_typename__.replace(".", "::") for kind in kinds}
        seen = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication).take(N=_MOST)
        return sorted({s.type_name for s in seen if s.topic_name == f"rt{name}"} - known)

    def readers(self, name: str) -> int:
        """How many readers a topic has now."""
        return len(matched(self._writers[name][1].get_matched_subscriptions))

    def _announce_node(self) -> None:
        """Publish which writers and readers the bench's node has, where it is shown as one."""
        if self._node is not None:
            self._node.announce(
                [writer for _, writer in self._writers.values()], [reader.entity for reader in self._readers]
            )

    def close(self) -> None:
        """Leave the domain after sending what was written, for at most a second. Idempotent; never raises."""
        self._writers.clear()
        for reader in self._readers:
            reader.close()
        self._node = self._participant = self._domain = None


def _quality(name: str) -> Qos:
    """Quality of service of a writer: ROS 2's default; reliable, which matches readers of either kind."""
    latched = name in LATCHED
    return Qos(
        Policy.Reliability.Reliable(_LONGEST_BLOCK),
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(1 if latched else _DEPTHS.get(name, _DEPTH)),
        _ENCODING,
    )
