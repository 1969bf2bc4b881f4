"""Shows the bench as a node in `ros2 node list`: publishes its writers and readers on `ros_discovery_info`.

ROS 2 learns from this topic which node has which endpoints of DDS. Identifiers are longer in Humble than in
later distributions, and one of the wrong length is misread. So the distribution has to be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from cyclonedds.core import Entity
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.topic import Topic

from hil.ros2.message_types import sample_type, type_store

_TOPIC = "ros_discovery_info"
_PACKAGE = "rmw_dds_common/msg/"
_ENTITIES = f"{_PACKAGE}ParticipantEntitiesInfo"


class NodeEntry:
    """Announces one node; DDS keeps the newest message for subscribers that come later.

    Args:
        participant: of Cyclone DDS.
        name: of the node.
        distribution: of ROS 2.
        quality: of a topic whose last message reaches later subscribers, too.
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
