"""A program that hears ROS 2 topics by Cyclone DDS alone: its types are written by hand, nothing is ours.

`listener.py DOMAIN TOPIC...` prints `matched` when every topic has a writer, and `heard` when the first has
had twenty messages. It hears until its input ends, waits until all writers are gone, and prints what came:
{"heard": {topic: [[source time in ns, CDR bytes as hex, fields], ...]}, "gone_after_s": seconds or null}.
"""

import dataclasses
import json
import select
import sys
import time
from dataclasses import dataclass

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
PATIENCE_S = 120.0
LATCHED = ("/tf_static", "/robot_description")


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
@final
class Clock(IdlStruct, typename="rosgraph_msgs.msg.dds_.Clock_"):
    clock: Time


@dataclass
@final
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
@final
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
@final
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
@final
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
@final
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
@final
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
@final
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
@final
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
@final
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
@final
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
@final
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
@final
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
@final
class KeyValue(IdlStruct, typename="diagnostic_msgs.msg.dds_.KeyValue_"):
    key: str
    value: str


@dataclass
@final
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
@final
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


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
    representation = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
    reliability = Policy.Reliability.Reliable(duration(milliseconds=100))
    return Qos(reliability, durability, Policy.History.KeepAll, representation)


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
    told = False
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
        if not told and len(heard[names[0]]) >= 20:
            told = True
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
