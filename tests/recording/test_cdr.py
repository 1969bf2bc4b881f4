"""CDR that is written here, held against rosbags: the same bytes as its classes give, for any values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from hil.recording import cdr
from hil.recording.rosbags_adapter import MessageMaker, to_cdr

STORE = get_typestore(Stores.ROS2_HUMBLE)
ROS = MessageMaker(1_700_000_000 * 10**9)
TIMES = st.integers(0, 10**18)
TEXTS = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=12)
NUMBERS = st.floats(width=64, allow_nan=False, allow_infinity=False)


def six(values):
    return np.array(values, dtype=np.float64)


@given(t_ns=TIMES, frame=TEXTS, values=st.lists(NUMBERS, min_size=7, max_size=7))
def test_a_pose(t_ns, frame, values):
    position_m, (w, *xyz) = values[:3], values[3:]
    whole = ROS.message(
        "geometry_msgs/msg/PoseStamped", header=ROS.header(t_ns, frame), pose=ROS.pose(position_m, (w, *xyz))
    )
    assert ROS.pose_stamped(t_ns, frame, position_m, (w, *xyz)) == to_cdr(whole)


@given(
    t_ns=TIMES,
    names=st.lists(TEXTS, max_size=9).map(tuple),
    columns=st.tuples(*[st.lists(NUMBERS, max_size=9)] * 3),
)
def test_joints(t_ns, names, columns):
    position, velocity, effort = map(six, columns)
    whole = ROS.message(
        "sensor_msgs/msg/JointState",
        header=ROS.header(t_ns, ""),
        name=list(names),
        position=position,
        velocity=velocity,
        effort=effort,
    )
    assert ROS.joints(t_ns, names, *columns) == to_cdr(whole)


@given(t_ns=TIMES, frame=TEXTS, child=TEXTS, values=st.lists(NUMBERS, min_size=85, max_size=85))
def test_odometry(t_ns, frame, child, values):
    position, quaternion, six_of_pose = values[:3], values[3:7], six(values[7:43])
    linear, angular, six_of_twist = values[43:46], values[46:49], six(values[49:])
    x, y, z, w = quaternion
    pose = ROS.message(
        "geometry_msgs/msg/PoseWithCovariance", pose=ROS.pose(position, (w, x, y, z)), covariance=six_of_pose
    )
    twist = ROS.message(
        "geometry_msgs/msg/TwistWithCovariance",
        twist=ROS.message("geometry_msgs/msg/Twist", linear=ROS.vector(linear), angular=ROS.vector(angular)),
        covariance=six_of_twist,
    )
    whole = ROS.message(
        "nav_msgs/msg/Odometry", header=ROS.header(t_ns, frame), child_frame_id=child, pose=pose, twist=twist
    )
    assert ROS.numbers(t_ns, (frame, child), values) == to_cdr(whole)


@pytest.mark.parametrize("t_ns", [-(10**19), -1, 0, 2**62])
def test_stamps_beyond_32_bits_are_clipped_alike(t_ns):
    whole = ROS.message("std_msgs/msg/Header", stamp=ROS.time(t_ns), frame_id="")
    assert ROS.joints(t_ns, ())[:12] == to_cdr(whole)[:12]


@given(payload=st.binary(max_size=300))
def test_octets(payload):
    nothing = ROS.message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    data = np.frombuffer(payload, dtype=np.uint8)
    assert cdr.octets(payload) == to_cdr(
        ROS.message("std_msgs/msg/UInt8MultiArray", layout=nothing, data=data)
    )


@given(t_ns=TIMES)
def test_a_clock(t_ns):
    whole = ROS.message("rosgraph_msgs/msg/Clock", clock=ROS.time(t_ns))
    assert cdr.clock(ROS.stamp(t_ns)) == to_cdr(whole)


FRAMES = st.tuples(st.tuples(TEXTS, TEXTS), st.lists(NUMBERS, min_size=7, max_size=7))


@given(t_ns=TIMES, frames=st.lists(FRAMES, max_size=4))
def test_transforms(t_ns, frames):
    placed = [
        ROS.message(
            "geometry_msgs/msg/TransformStamped",
            header=ROS.header(t_ns, parent),
            child_frame_id=child,
            transform=ROS.message(
                "geometry_msgs/msg/Transform",
                translation=ROS.vector((x, y, z)),
                rotation=ROS.quaternion((qw, qx, qy, qz)),
            ),
        )
        for (parent, child), (x, y, z, qx, qy, qz, qw) in frames
    ]
    whole = ROS.message("tf2_msgs/msg/TFMessage", transforms=placed)
    assert cdr.transforms(ROS.stamp(t_ns), frames) == to_cdr(whole)
