"""A program that hears ROS 2 topics by Cyclone DDS alone: nothing is ours.

`listener.py DOMAIN TOPIC...` prints `matched` when every topic has a writer, and `heard` when the first has
had twenty messages. It hears until its input ends, waits until all writers are gone, and prints what came:
{"heard": {topic: [[source time in ns, CDR bytes as hex, fields], ...]}, "gone_after_s": seconds or null}.
"""

import dataclasses
import json
import select
import sys
import time

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from dds_types import (
    LOOPBACK,
    RELIABLE,
    REPRESENTATION,
    Clock,
    DiagnosticArray,
    Imu,
    JointState,
    Odometry,
    PoseStamped,
    String,
    TFMessage,
)

PATIENCE_S = 120.0
LATCHED = ("/tf_static", "/robot_description")

TYPES = {
    "/clock": Clock,
    "/joint_states": JointState,
    "/robot_joint_states": JointState,
    "/imu/data": Imu,
    "/mocap/pose": PoseStamped,
    "/tracker/pose": PoseStamped,
    "/odom": Odometry,
    "/tf": TFMessage,
    "/tf_static": TFMessage,
    "/robot_description": String,
    "/diagnostics": DiagnosticArray,
}


def quality(name):
    """As an ordinary ROS 2 subscription, but for a queue that holds everything."""
    durability = Policy.Durability.TransientLocal if name in LATCHED else Policy.Durability.Volatile
    return Qos(RELIABLE, durability, Policy.History.KeepAll, REPRESENTATION)


def main():
    names = sys.argv[2:]
    domain = Domain(int(sys.argv[1]), LOOPBACK)
    participant = DomainParticipant(int(sys.argv[1]))
    readers = {
        name: DataReader(participant, Topic(participant, f"rt{name}", TYPES[name]), quality(name))
        for name in names
    }
    everything = SampleState.Any | ViewState.Any | InstanceState.Any
    heard = {name: [] for name in names}
    matched = ended = gone = None
    reported = False
    until = time.monotonic() + PATIENCE_S
    while gone is None and time.monotonic() < until:
        for name, reader in readers.items():
            for data, info in ddspy_take(reader._ref, everything, 1000):
                if info.valid_data:
                    fields = dataclasses.asdict(TYPES[name].deserialize(data))
                    heard[name].append([info.source_timestamp, data.hex(), fields])
        writers = [len(reader.get_matched_publications()) for reader in readers.values()]
        if matched is None and all(writers):
            matched = True
            print("matched", flush=True)
        if not reported and len(heard[names[0]]) >= 20:
            reported = True
            print("heard", flush=True)
        if ended is None:
            if select.select([sys.stdin], [], [], 0.001)[0] and not sys.stdin.readline():
                ended = time.monotonic()
        elif not any(writers):
            gone = time.monotonic() - ended
        else:
            time.sleep(0.001)
    print(json.dumps({"heard": heard, "gone_after_s": gone}))
    del domain


if __name__ == "__main__":
    main()
