"""What the numbers of an ODOMETRY message mean, held against scipy's rotations and pymavlink's packing."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.core.signals import Status
from hil.links.mavlink import messages as odometry_messages

LOCAL_NED, LOCAL_ENU, BODY_NED, BODY_FRD, BODY_FLU, LOCAL_FRD, LOCAL_FLU = 1, 4, 8, 12, 13, 20, 21
DOWN, UP = np.diag([1.0, -1.0, -1.0]), np.eye(3)
WORLDS = {LOCAL_NED: DOWN, LOCAL_FRD: DOWN, LOCAL_FLU: UP, LOCAL_ENU: UP}
"""Axes of each frame as columns, in forward-left-up axes (NED and ENU: of north-west-up and of itself)."""
BODIES = {BODY_NED: DOWN, BODY_FRD: DOWN, BODY_FLU: UP}

POSITION = np.array([0.3, -0.2, 0.7])
ATTITUDE = Rotation.from_euler("ZYX", [0.8, -0.3, 1.1]).as_matrix()
VELOCITY, RATES = np.array([0.05, -0.02, 0.01]), np.array([0.1, 0.2, -0.4])


@pytest.mark.parametrize(
    ("frame", "child", "body_axes"),
    [
        *[(*pair, None) for pair in itertools.product(WORLDS, BODIES)],
        *[(frame, frame, None) for frame in WORLDS],
        (LOCAL_FLU, BODY_FRD, "FLU"),
        (LOCAL_FRD, BODY_FRD, "FLU"),
        (LOCAL_FLU, LOCAL_FLU, "FRD"),
    ],
)
def test_every_pair_of_frames_gives_back_the_motion(common, odometry, frame, child, body_axes):
    """Written down by matrices whose columns are the axes of each frame, packed by pymavlink, read back."""
    world, twist_axes = WORLDS[frame], BODIES.get(child, WORLDS.get(child))
    body = {"FRD": DOWN, "FLU": UP}[body_axes] if body_axes else twist_axes
    sent = Rotation.from_matrix(world.T @ ATTITUDE @ body).as_quat()[[3, 0, 1, 2]]
    moves = twist_axes.T if child in WORLDS else (ATTITUDE @ twist_axes).T
    message = odometry(
        frame_id=frame,
        child_frame_id=child,
        q=sent.tolist(),
        **dict(zip("xyz", (world.T @ POSITION).tolist(), strict=True)),
        **dict(zip(("vx", "vy", "vz"), (moves @ VELOCITY).tolist(), strict=True)),
        **dict(zip(("rollspeed", "pitchspeed", "yawspeed"), (moves @ RATES).tolist(), strict=True)),
    )
    (received,) = odometry_messages.Parser(common, datagrams=True).feed(
        bytes(message.pack(common.MAVLink(None)))
    )
    axes = odometry_messages.axes_of(received.frame_id, received.child_frame_id, body_axes)
    pose = odometry_messages.pose_of(received, axes)
    np.testing.assert_allclose(pose[:3], POSITION, atol=1e-7)
    found = Rotation.from_quat(np.array(pose[3:])[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found, ATTITUDE, atol=1e-6)
    twist = odometry_messages.twist_of(received, axes, pose[3:])
    np.testing.assert_allclose(twist[:3], VELOCITY, atol=1e-7)
    np.testing.assert_allclose(twist[3:], RATES, atol=1e-6)


def test_a_level_camera_that_drives_forward_right_and_up_in_local_frd(odometry):
    """By hand: 1 m forward, 2 m to the right, 3 m up, turned to the left by 0.2 rad."""
    message = odometry(x=1.0, y=2.0, z=-3.0, q=[np.cos(0.1), 0.0, 0.0, -np.sin(0.1)], vx=0.1, yawspeed=-0.5)
    axes = odometry_messages.axes_of(LOCAL_FRD, BODY_FRD)
    pose = odometry_messages.pose_of(message, axes)
    np.testing.assert_allclose(pose, [1, -2, 3, np.cos(0.1), 0, 0, np.sin(0.1)], atol=1e-7)
    twist = odometry_messages.twist_of(message, axes, pose[3:])
    expected = [0.1 * np.cos(0.2), 0.1 * np.sin(0.2), 0, 0, 0, 0.5]
    np.testing.assert_allclose(twist, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("frame", "child"),
    [
        (0, BODY_FRD),
        (BODY_FRD, BODY_FRD),
        (LOCAL_FRD, LOCAL_NED),
        (LOCAL_FRD, LOCAL_FLU),
        (LOCAL_FRD, 14),
        (99, 99),
    ],
)
def test_frames_that_cannot_be_used_together_have_no_axes(frame, child):
    """A global frame, a pose in body axes, a twist in another local frame, numbers that mean nothing."""
    assert odometry_messages.axes_of(frame, child) is None


def triangle(matrix):
    return matrix[np.triu_indices(6)].tolist()


def test_a_covariance_is_an_upper_triangle_by_rows_turned_into_the_start_frame(odometry):
    root = np.random.default_rng(3).standard_normal((6, 6))
    covariance = root @ root.T
    message, down = odometry(pose_covariance=triangle(covariance)), np.kron(np.eye(2), DOWN)
    found = odometry_messages.pose_covariance(message, odometry_messages.axes_of(LOCAL_FRD, BODY_FRD))
    np.testing.assert_allclose(found, down @ covariance @ down.T, rtol=1e-6)


def test_a_covariance_that_is_not_given_or_cannot_be_is_none(odometry):
    axes = odometry_messages.axes_of(LOCAL_FRD, BODY_FRD)
    unknown = odometry()
    assert odometry_messages.pose_covariance(unknown, axes) is None
    negative = odometry(pose_covariance=triangle(np.diag([1.0, 1, -1, 1, 1, 1])))
    assert odometry_messages.pose_covariance(negative, axes) is None


def packed(common, *parts):
    writer = common.MAVLink(None, srcSystem=1, srcComponent=197)
    return [bytes(part.pack(writer)) for part in parts]


def test_a_damaged_datagram_does_not_spoil_the_next_one_and_a_stream_goes_on(common, odometry):
    first, second = packed(common, odometry(1.0), odometry(2.0))
    datagrams = odometry_messages.Parser(common, datagrams=True)
    assert datagrams.feed(first[:-40]) == []
    assert [m.time_usec for m in datagrams.feed(second)] == [2_000_000]
    damaged = bytearray(first)
    damaged[30] ^= 1
    assert [m.get_type() for m in datagrams.feed(bytes(damaged))] == ["BAD_DATA"]
    stream = odometry_messages.Parser(common, datagrams=False)
    assert stream.feed(first[:100]) == []
    assert [m.time_usec for m in stream.feed(first[100:] + second)] == [1_000_000, 2_000_000]


def test_a_message_of_the_first_protocol_version_and_one_without_extensions_are_read(common, odometry):
    """MAVLink 2 leaves trailing zeros out, older senders know no reset counter and no quality."""
    plain = odometry(quality=0, reset_counter=0, estimator_type=0)
    (data,) = packed(common, plain)
    assert len(data) < 12 + 230 + 3
    (received,) = odometry_messages.Parser(common, datagrams=True).feed(data)
    assert (received.quality, received.reset_counter) == (0, 0)
    beat = common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    old = bytes(beat.pack(common.MAVLink(None), force_mavlink1=True))
    assert [m.get_type() for m in odometry_messages.Parser(common, datagrams=True).feed(old)] == ["HEARTBEAT"]


@given(st.lists(st.binary(max_size=300), max_size=6), st.booleans())
def test_no_bytes_at_all_break_the_parser(pieces, datagrams):
    common = pytest.importorskip("pymavlink.dialects.v20.common", reason="the extra mavlink is not installed")
    parser = odometry_messages.Parser(common, datagrams=datagrams)
    for piece in pieces:
        for marker in (b"", b"\xfd", b"\xfe"):
            for message in parser.feed(marker + piece):
                assert message.get_type()


def test_a_vision_position_estimate_says_the_same_pose(common):
    """As the T265 scripts for ArduPilot send it: NED, with roll, pitch and yaw of a body with z down."""
    sent = Rotation.from_matrix(DOWN.T @ ATTITUDE @ DOWN).as_euler("ZYX")
    x, y, z = (DOWN.T @ POSITION).tolist()
    estimate = common.MAVLink_vision_position_estimate_message(
        1_000_000, x, y, z, sent[2], sent[1], sent[0], [0.0] * 21, 3
    )
    (received,) = odometry_messages.Parser(common, datagrams=True).feed(
        bytes(estimate.pack(common.MAVLink(None)))
    )
    message = odometry_messages.odometry_of(received, common)
    axes = odometry_messages.axes_of(message.frame_id, message.child_frame_id)
    pose = odometry_messages.pose_of(message, axes)
    np.testing.assert_allclose(pose[:3], POSITION, atol=1e-6)
    found = Rotation.from_quat(np.array(pose[3:])[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found, ATTITUDE, atol=1e-6)
    assert np.isnan(odometry_messages.twist_of(message, axes, pose[3:])).all()
    assert odometry_messages.pose_covariance(message, axes) is None
    assert message.reset_counter == 3


def test_a_sender_of_vision_position_estimates_is_a_tracker(by_hand, common):
    def estimate(time_s, x_m):
        return common.MAVLink_vision_position_estimate_message(
            round(time_s * 1e6), x_m, 0.0, 0.0, 0.0, 0.0, 0.0, [0.0] * 21, 0
        )

    bench = by_hand(opened=False)
    for _ in range(3):
        bench.link.arrive(estimate(1.0, 0.0))
    bench.driver.open()
    samples = []
    for k in range(1, 30):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        bench.link.arrive(estimate(1.0 + 0.01 * k, 0.001 * k))
        samples += bench.driver.read()
    assert len(samples) == 29
    assert all(s.status is Status.OK for s in samples)
    assert samples[-1].position_m[0] == pytest.approx(0.029)
