"""What other programs hear of a bench on ROS 2: a listener on Cyclone DDS, and rosbags as a second reader."""

from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from hil.core.errors import SafetyStop
from hil.procedure.bench_source import BenchSource
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line
from tests.patience import PATIENT

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network
from hil.ros2.publisher import Ros2Publisher

pytestmark = pytest.mark.timeout(180)
MOVING = ("/joint_states", "/imu/data", "/mocap/pose", "/tracker/pose", "/odom", "/tf", "/diagnostics")
STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/mocap/pose": "geometry_msgs/msg/PoseStamped",
    "/tracker/pose": "geometry_msgs/msg/PoseStamped",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/robot_description": "std_msgs/msg/String",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
S = 1_000_000_000


@pytest.fixture
def publisher(domain):
    made = Ros2Publisher(Network(domain))
    yield made
    made.close()


def source(publisher, **options):
    return BenchSource("emulated", publish=publisher.sink, **options)


def read(topic, message):
    """A message by rosbags."""
    return STORE.deserialize_cdr(bytes.fromhex(message[1]), TYPES[topic])


def stamp_ns(time):
    return time.sec * S + time.nanosec


def recorded(path):
    """Messages of a recording as they are in the file: by topic, CDR bytes in their order."""
    found = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message.data)
    return found


def padded(data):
    """As DDS carries it: a whole number of four bytes."""
    return data + bytes(-len(data) % 4)


@pytest.mark.alone
def test_in_real_time_the_bytes_of_the_recording_go_out(publisher, listen, tmp_path):
    topics = [topic for topic in MOVING if topic != "/diagnostics"]
    bench = source(publisher, realtime=True, overrides=PATIENT).open()
    listener = listen(*topics)
    with bench:
        bench.add_sink(McapRecorder(tmp_path / "r.mcap", bench.header(), lossless=False))
        listener.wait(publisher.participant, *topics)
        bench.observe(1.0)
    publisher.close()
    heard, gone_after_s = listener.heard()
    written = recorded(tmp_path / "r.mcap")
    for topic in topics:
        sent = [padded(data) for data in written[topic]]
        came = [bytes.fromhex(message[1]) for message in heard[topic]]
        assert set(came) <= set(sent)
        assert len(came) >= 0.5 * len(sent) > 10
        for _, data, fields in heard[topic][:5]:  # two readers that share no code with the writer agree
            seen = STORE.deserialize_cdr(bytes.fromhex(data), TYPES[topic])
            _agree(fields, seen)
    assert gone_after_s < 5.0, "what ends its program is not taken for alive until its lease is over"


def _agree(fields, seen):
    """Fields by Cyclone DDS and a message by rosbags say the same."""
    for name, value in fields.items():
        other = getattr(seen, name)
        if isinstance(value, dict):
            _agree(value, other)
        elif value and isinstance(value, list) and isinstance(value[0], dict):
            for one, two in zip(value, other, strict=True):
                _agree(one, two)
        else:
            np.testing.assert_array_equal(value, other)


@pytest.mark.real_time
def test_virtual_time_never_goes_back_and_states_are_sent_before_the_time_that_nodes_act_by(
    publisher, listen
):
    topics = ("/clock", "/joint_states", "/odom")
    listener = listen(*topics)
    states = []
    for number in range(2):
        with source(publisher).open() as bench:
            if number == 0:
                listener.wait(publisher.participant, *topics)
            motion = bench.observe(0.5)
            states.append([record.inputs.servos[0] for record in motion.records if record.inputs.servos])
    publisher.close()
    heard, _ = listener.heard()
    clocks = [stamp_ns(read("/clock", message).clock) for message in heard["/clock"]]
    assert len(clocks) > 20
    assert clocks[0] >= S
    assert all(later > earlier for earlier, later in pairwise(clocks))
    joints = {
        stamp_ns((j := read("/joint_states", m)).header.stamp): j.position for m in heard["/joint_states"]
    }
    first = {sample.stamp.t_ns + S: sample for sample in states[0]}
    both = first.keys() & joints.keys()
    assert len(both) > 10
    for t_ns in both:
        np.testing.assert_array_equal(joints[t_ns], first[t_ns].position_rad)
    sent = {stamp_ns(read("/odom", m).header.stamp): m[0] for m in heard["/odom"]}
    told = {t_ns: message[0] for t_ns, message in zip(clocks, heard["/clock"], strict=True)}
    both = sent.keys() & told.keys()
    assert len(both) > 10
    assert all(sent[t_ns] < told[t_ns] for t_ns in both)


@pytest.mark.real_time
def test_who_listens_later_gets_what_never_moves(publisher, listen):
    with source(publisher).open() as bench:
        bench.observe(0.1)
        listener = listen("/tf_static", "/robot_description")
        listener.matched()
        bench.observe(0.1)
        listener.end()
    publisher.close()
    heard, _ = listener.heard()
    (frames,), (robot,) = heard["/tf_static"], heard["/robot_description"]
    named = {(t.header.frame_id, t.child_frame_id) for t in read("/tf_static", frames).transforms}
    assert {("wall", "mocap"), ("body", "imu")} <= named
    assert read("/robot_description", robot).data.startswith("<")


@pytest.mark.real_time
def test_diagnostics_name_the_stop_and_how_the_robot_was_left(publisher, listen):
    listener = listen("/diagnostics")
    bench = source(publisher, faults=("servos:off@1.5",)).open()
    with bench:
        listener.wait(publisher.participant, "/diagnostics")
        with pytest.raises(SafetyStop) as ended:
            bench.drive(line((0.0, 0.0, 0.0), (0.3, 0.0, 0.0)))
    publisher.close()
    heard, _ = listener.heard()
    answer = [status for m in heard["/diagnostics"] for status in read("/diagnostics", m).status]
    errors = [s for s in answer if s.level == 2 and s.name != "hil: held"]
    assert errors[-1].message == str(ended.value)
    (held,) = (s for s in answer if s.name == "hil: held")
    assert held.message == f"{bench.held.state}: {bench.held.why}"
    assert held.level == (0 if bench.held.state == "HELD" else 2)
    assert {s.hardware_id for s in answer} == {bench.config.name}
