"""What the ROS 2 messages of a cycle hold, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_cases import driving_record
from recorded import HEADER, STORE

from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.core.signals import SERVOS
from hil.recording import cdr
from hil.recording.ros_messages import CycleMessages
from hil.recording.rosbags_adapter import MessageMaker, definition, from_cdr
from hil.recording.topics import topics_with
from hil.recording.transform_tree import FrameTree

KINDS = tuple(kinds().values())
TOPICS = topics_with(KINDS)


def messages(k):
    return CycleMessages(KINDS, FrameTree(HEADER)).of(driving_record(k))


def by_topic(k):
    return {t: STORE.deserialize_cdr(data, TOPICS[t]) for t, _, data in messages(k)}


def test_values_arrive_where_ros_expects_them():
    record, found = driving_record(3), by_topic(3)
    servos = record.inputs.servos[0]
    joints = found["/joint_states"]
    assert tuple(joints.name) == SERVOS
    np.testing.assert_array_equal(joints.position, servos.position_rad)
    np.testing.assert_array_equal(joints.effort, servos.current_a)
    assert (joints.header.stamp.sec, joints.header.stamp.nanosec) == (0, 30_000_000)
    imu = found["/imu/data"]
    assert imu.linear_acceleration.x == pytest.approx(9.8, abs=0.01)
    assert (imu.orientation.w, imu.orientation.x) == (1.0, 0.0)
    odom = found["/odom"]
    assert (odom.header.frame_id, odom.child_frame_id) == ("wall", "body")
    x_m, y_m, theta_rad = record.state.pose_body_in_wall
    assert (odom.pose.pose.position.x, odom.pose.pose.position.y) == (x_m, y_m)
    assert 2 * np.arctan2(odom.pose.pose.orientation.z, odom.pose.pose.orientation.w) == pytest.approx(
        theta_rad
    )
    np.testing.assert_array_equal(
        np.flatnonzero(odom.pose.covariance), [0, 7, 35], err_msg="x, y and yaw of the 6x6 matrix"
    )
    encoders = found["/steering_encoders"]
    assert tuple(encoders.name) == SERVOS[4:]
    np.testing.assert_array_equal(encoders.position, record.inputs.encoders[0].angle_rad)
    assert len(encoders.velocity) == len(encoders.effort) == 0
    assert found["/hil/events"].level == 30
    assert found["/hil/events"].msg == "stale for 0.5 s"


def test_a_planar_covariance_has_its_places_in_that_of_six():
    record, covariance = driving_record(3), np.arange(1.0, 37.0).reshape(6, 6)
    state = replace(record.state, covariance=covariance, twist_body=np.array([0.1, 0.2, 0.3]))
    sent = CycleMessages(KINDS, FrameTree(HEADER)).of(replace(record, state=state))
    (data,) = [data for topic, _, data in sent if topic == "/odom"]
    odom = STORE.deserialize_cdr(data, TOPICS["/odom"])
    for found, part in ((odom.pose, covariance[:3, :3]), (odom.twist, covariance[3:, 3:])):
        whole = np.zeros((6, 6))
        whole[np.ix_((0, 1, 5), (0, 1, 5))] = part
        np.testing.assert_array_equal(found.covariance, whole.ravel())
    velocity = odom.twist.twist
    assert (velocity.linear.x, velocity.linear.y, velocity.angular.z) == (0.1, 0.2, 0.3)
    assert (velocity.linear.z, velocity.angular.x, velocity.angular.y) == (0.0, 0.0, 0.0)


@given(payload=st.binary(max_size=300), text=st.text(max_size=80))
def test_cycles_and_notes_come_back_as_they_were_given(payload, text):
    made = CycleMessages(KINDS, FrameTree(HEADER))
    (topic, _, data), (about, _, note) = made.cycle(0, payload), made.note(0, text)
    assert bytes(from_cdr(data, TOPICS[topic]).data) == payload
    assert from_cdr(note, TOPICS[about]).data == text


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", cdr.octets(b"abc")[:-1], b"\0\1\0\0" + bytes([1] * 20)])
@pytest.mark.parametrize("topic", ["/hil/cycle", "/hil/notes"])
def test_bytes_that_are_no_message_are_refused(data, topic):
    with pytest.raises(ValueError):
        from_cdr(data, TOPICS[topic])


LATEST_S = 2**31 - 1


@pytest.mark.parametrize(
    ("t_ns", "wall_ns", "reported"),
    [
        (0, 0, (0, 0)),
        (-1, 0, (0, 0)),
        (5, 1_700_000_000 * 10**9, (1_700_000_000, 5)),
        (-(10**9), 3 * 10**9 + 7, (2, 7)),
        (LATEST_S * 10**9 + 999_999_999, 0, (LATEST_S, 999_999_999)),
        (2**62, 2**62, (LATEST_S, 999_999_999)),
    ],
)
def test_stamps_are_wall_clock_time_as_far_as_32_bits_reach(t_ns, wall_ns, reported):
    time = MessageMaker(wall_ns).time(t_ns)
    assert (time.sec, time.nanosec) == reported


def test_a_type_that_ros_does_not_have_is_named():
    with pytest.raises(ConfigError, match="message type 'hil_msgs/msg/Nothing' cannot be recorded"):
        definition("hil_msgs/msg/Nothing")
