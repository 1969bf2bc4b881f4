"""The ROS 2 messages of a cycle record: samples as their kinds say, estimate, reference, events, frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain

from hil.recording.cdr import TIME, CdrForm, CdrWriter, Doubles
from hil.recording.frames import BODY, WALL, Frame
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind
from hil.vocabulary.signals import CycleRecord, Event, Reference, RobotState

Message = tuple[str, int, bytes]
"""Topic, time of measurement (bench clock, ns), CDR bytes."""

TOPICS = {
    "/hil/cycle": "std_msgs/msg/UInt8MultiArray",
    "/hil/notes": "std_msgs/msg/String",
    "/hil/events": "rcl_interfaces/msg/Log",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/robot_description": "std_msgs/msg/String",
    "/odom": "nav_msgs/msg/Odometry",
    "/reference": "geometry_msgs/msg/PoseStamped",
}
"""Topics that belong to no device, with their types."""

_LOG_LEVEL = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}
_ZEROS = (0.0,) * 18
_ODOMETRY = CdrForm(TIME, WALL, BODY, Doubles(7 + 36 + 6 + 36))
_REFERENCE = CdrForm(TIME, WALL, Doubles(7))
_CLOCK = CdrForm(TIME)


def topics_with(kinds: Sequence[DeviceKind]) -> dict[str, str]:
    """All topics of a recording with their types; those of a kind only if it is among `kinds`."""
    return {**TOPICS, **{topic.name: topic.type for kind in kinds for topic in kind.topics}}


def transforms(t_ns: int, frames: tuple[Frame, ...], wall_ns: int = 0) -> bytes:
    """`tf2_msgs/TFMessage`."""
    form = _transform_form(tuple([(frame.parent, frame.child) for frame in frames]))
    places = []
    for frame in frames:
        w, x, y, z = frame.quaternion_wxyz
        places.append((*frame.position_m, x, y, z, w))
    return form.pack(t_ns, wall_ns, *places)


@lru_cache(maxsize=64)
def _transform_form(names: tuple[tuple[str, str], ...]) -> CdrForm:
    parts = chain.from_iterable((TIME, parent, child, Doubles(7)) for parent, child in names)
    return CdrForm(len(names), *parts)


def _planar_pose(pose: Array) -> tuple[float, ...]:
    """Position, and quaternion in the order of ROS."""
    x_m, y_m, theta_rad = pose.tolist()
    return x_m, y_m, 0.0, 0.0, 0.0, math.sin(0.5 * theta_rad), math.cos(0.5 * theta_rad)


def _spatial_covariance(planar: Array) -> tuple[float, ...]:
    """Covariance of six (36 numbers) from that (3, 3) of x, y and the turn about z."""
    (xx, xy, xt), (yx, yy, yt), (tx, ty, tt) = planar.tolist()
    return (
        xx, xy, 0.0, 0.0, 0.0, xt,
        yx, yy, 0.0, 0.0, 0.0, yt,
        *_ZEROS,
        tx, ty, 0.0, 0.0, 0.0, tt,
    )  # fmt: skip


def odometry(state: RobotState, wall_ns: int = 0) -> bytes:
    """`nav_msgs/Odometry` of an estimate: pose in the wall frame, twist in the body frame."""
    v_x, v_y, omega = state.twist_body.tolist()
    numbers = (
        *_planar_pose(state.pose_body_in_wall), *_spatial_covariance(state.covariance[:3, :3]),
        v_x, v_y, 0.0, 0.0, 0.0, omega, *_spatial_covariance(state.covariance[3:6, 3:6]),
    )  # fmt: skip
    return _ODOMETRY.pack(state.t_ns, wall_ns, numbers)


def _reference(t_ns: int, reference: Reference, wall_ns: int) -> bytes:
    return _REFERENCE.pack(t_ns, wall_ns, _planar_pose(reference.pose_in_wall))


def log(event: Event, wall_ns: int = 0) -> bytes:
    """`rcl_interfaces/Log` of an event."""
    cdr = CdrWriter(wall_ns)
    cdr.time(event.t_ns)
    cdr.u8(_LOG_LEVEL.get(event.level, _LOG_LEVEL["warning"]))
    cdr.text(event.source)
    cdr.text(event.message)
    cdr.text("")
    cdr.text("")
    cdr.u32(0)
    return cdr.bytes()


def messages(record: CycleRecord, kinds: Sequence[DeviceKind], wall_ns: int = 0) -> Iterator[Message]:
    """ROS 2 messages of one cycle.

    Args:
        record: the cycle.
        kinds: of the devices whose samples are wanted.
        wall_ns: wall-clock time at the bench clock's zero; the messages' own stamps are wall-clock time.
    """
    inputs = record.inputs
    yield "/clock", record.start_ns, _CLOCK.pack(record.start_ns, wall_ns)
    for kind in kinds:
        for topic in kind.topics:
            for sample in inputs.of(kind.name):
                yield topic.name, sample.stamp.t_ns, topic.encode(sample, wall_ns)
    yield "/odom", record.state.t_ns, odometry(record.state, wall_ns)
    if record.reference is not None:
        yield "/reference", inputs.t_ns, _reference(inputs.t_ns, record.reference, wall_ns)
    for event in record.events:
        yield "/hil/events", event.t_ns, log(event, wall_ns)
