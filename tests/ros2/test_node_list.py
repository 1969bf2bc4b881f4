"""`ros2 node list` shows the bench: a reader with types written by hand finds it on `ros_discovery_info`."""

import time
from dataclasses import dataclass

import pytest

from hil.config.loading import load_bench
from hil.core.errors import ConfigError
from hil.procedure.bench_source import BenchSource
from hil.ros2.network import network_of

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, bounded_str, sequence, uint8
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from hil.ros2.network import Network
from hil.ros2.publisher import Ros2Publisher

TOPIC = "/joint_commands"
PATIENCE_S = 60.0


def entities(length):
    """The type of `ros_discovery_info` with identifiers of so many bytes."""

    @dataclass
    @final
    class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
        data: array[uint8, length]

    @dataclass
    @final
    class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
        node_namespace: bounded_str[256]
        node_name: bounded_str[256]
        reader_gid_seq: sequence[Gid]
        writer_gid_seq: sequence[Gid]

    @dataclass
    @final
    class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
        gid: Gid
        node_entities_info_seq: sequence[NodeEntitiesInfo]

    return ParticipantEntitiesInfo


class Onlooker:
    """A participant as a ROS 2 node has it, in a domain that the bench has joined."""

    def __init__(self, domain):
        self.participant = DomainParticipant(domain)

    def wait(self, seen):
        until = time.monotonic() + PATIENCE_S
        while not (found := seen()):
            assert time.monotonic() < until
            time.sleep(0.05)
        return found

    def told(self, length):
        """Reads the newest message, as soon as there is one; what came is kept by the writer alone."""
        quality = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)),
            Policy.Durability.TransientLocal,
            Policy.History.KeepAll,
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )
        topic = Topic(self.participant, "ros_discovery_info", entities(length))
        reader = DataReader(self.participant, topic, quality)
        return self.wait(lambda: reader.take(N=10))[-1]

    def others(self, builtin):
        """Topic and GUID of each endpoint of others that DDS itself has found until now."""
        seen = BuiltinDataReader(self.participant, builtin).read(N=1000)
        mine = self.participant.get_guid()
        return {(one.topic_name, one.key.bytes) for one in seen if one.participant_key != mine}

    def finds(self, builtin, guids):
        """Waits until DDS itself has found these endpoints of ROS 2 topics, and no others."""
        self.wait(lambda: {key for name, key in self.others(builtin) if name.startswith("rt/")} == guids)


@pytest.mark.timeout(120)
@pytest.mark.parametrize(("distribution", "length"), [("humble", 24), ("jazzy", 16)])
def test_the_bench_is_a_node_with_all_its_writers_and_readers(distribution, length, domain):
    publisher = Ros2Publisher(Network(domain, distribution=distribution, node="the_bench"), TOPIC)
    try:
        source = BenchSource("emulated_floor", controller=f"ros2:{TOPIC}", publish=publisher.sink)
        with source.open():
            looks = Onlooker(domain)
            told = looks.told(length)
            (node,) = told.node_entities_info_seq
            looks.finds(BuiltinTopicDcpsPublication, {bytes(gid.data)[:16] for gid in node.writer_gid_seq})
            looks.finds(BuiltinTopicDcpsSubscription, {bytes(gid.data)[:16] for gid in node.reader_gid_seq})
    finally:
        publisher.close()
    assert (node.node_namespace, node.node_name) == ("/", "the_bench")
    identifiers = [told.gid, *node.writer_gid_seq, *node.reader_gid_seq]
    assert not any(any(gid.data[16:]) for gid in identifiers)
    assert len(node.writer_gid_seq) > 5
    assert len(node.reader_gid_seq) == 3, "of each type that can command"
    assert {bytes(gid.data)[:12] for gid in node.writer_gid_seq} == {bytes(told.gid.data)[:12]}


@pytest.mark.parametrize(("key", "value"), [("ros2.distribution", "noetic"), ("ros2.node", "my bench")])
def test_what_ros_2_does_not_know_is_refused(key, value):
    with pytest.raises(ConfigError, match=key.replace(".", r"\.")):
        load_bench("emulated", overrides={key: value})


def test_the_bench_file_names_the_distribution_and_the_node():
    named = {"ros2.distribution": "jazzy", "ros2.node": "lab_3"}
    network = network_of(load_bench("emulated", overrides=named).ros2, {})
    assert (network.distribution, network.node) == ("jazzy", "lab_3")
    assert network_of(load_bench("emulated").ros2, {}).distribution is None
