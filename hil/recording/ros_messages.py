"""The ROS 2 messages of a cycle record: samples, estimate, reference, events, frames."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from rosbags.typesys.stores.ros2_humble import rcl_interfaces__msg__Log as Log
from rosbags.typesys.stores.ros2_humble import std_msgs__msg__String as String

from hil.core.device import DeviceKind
from hil.core.geometry import Array
from hil.core.signals import CycleRecord, Event, RobotState, samples_of
from hil.recording import cdr
from hil.recording.ros_types import MessageMaker, pose_numbers, to_cdr
from hil.recording.transform_tree import BODY, WALL, Frame, FrameTree

Message = tuple[str, int, bytes]
"""Topic, time of measurement (bench clock, ns), CDR bytes."""

_LOG_LEVEL = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}
_PLANAR = (0, 1, 5, 6, 7, 11, 30, 31, 35)
"""Indices of x, y and rotation about z in a covariance (6, 6), flattened to 36 numbers."""


def transforms(t_ns: int, frames: Sequence[Frame], ros: MessageMaker) -> bytes:
    """`tf2_msgs/TFMessage`."""
    placed = [((f.parent, f.child), pose_numbers(f.position_m, f.quaternion_wxyz)) for f in frames]
    return cdr.transforms(ros.stamp(t_ns), placed)


def log(event: Event, ros: MessageMaker) -> Any:
    """`rcl_interfaces/Log` of an event."""
    return Log(
        stamp=ros.time(event.t_ns),
        level=_LOG_LEVEL.get(event.level, _LOG_LEVEL["warning"]),
        name=event.source,
        msg=event.message,
        file="",
        function="",
        line=0,
    )


def _place(planar: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position (3,) m and quaternion (4,), w first, of a planar pose."""
    x_m, y_m, theta_rad = planar.tolist()
    return (x_m, y_m, 0.0), (math.cos(0.5 * theta_rad), 0.0, 0.0, math.sin(0.5 * theta_rad))


def _of_six(planar: Array) -> list[float]:
    """Covariance (36,) of a pose or twist in space from that of x, y and rotation about z, (3, 3)."""
    whole = [0.0] * 36
    for place, value in zip(_PLANAR, planar.ravel().tolist(), strict=True):
        whole[place] = value
    return whole


def _odometry(state: RobotState, ros: MessageMaker) -> bytes | None:
    """`nav_msgs/Odometry` of an estimate: pose in the wall frame, twist in the body frame."""
    forward, left, spin = state.twist_body.tolist()
    pose = (*pose_numbers(*_place(state.pose_body_in_wall)), *_of_six(state.covariance[:3, :3]))
    twist = (forward, left, 0.0, 0.0, 0.0, spin, *_of_six(state.covariance[3:, 3:]))
    return ros.numbers(state.t_ns, (WALL, BODY), (*pose, *twist))


class CycleMessages:
    """ROS 2 messages of the cycles of a recording.

    Args:
        kinds: kinds of the devices whose samples are wanted.
        frames: frame tree of the recording; follows its cycles.
        wall_ns: wall-clock time at the bench clock's zero; the messages' own stamps are wall-clock time.
    """

    def __init__(self, kinds: Sequence[DeviceKind], frames: FrameTree, wall_ns: int = 0) -> None:
        self._frames, self._ros = frames, MessageMaker(wall_ns)
        self._topics = [
            (topic.name, samples_of(kind.name), topic.message) for kind in kinds for topic in kind.topics
        ]

    def cycle(self, t_ns: int, encoded: bytes) -> Message:
        """The cycle record itself."""
        return "/hil/cycle", t_ns, cdr.octets(encoded)

    def note(self, t_ns: int, note: str) -> Message:
        """A note between two cycles."""
        return "/hil/notes", t_ns, to_cdr(String(note))

    def first(self, t_ns: int, description: str) -> Iterator[Message]:
        """Static messages, once per recording: fixed frames, and the robot's URDF unless it is empty."""
        yield "/tf_static", t_ns, transforms(t_ns, self._frames.fixed, self._ros)
        if description:
            yield "/robot_description", t_ns, to_cdr(String(description))

    def of(self, record: CycleRecord) -> Iterator[Message]:
        """Messages of one cycle, generated lazily; to be called with the cycles in order."""
        for topic, t_ns, made in self._made(record):
            if made is not None:  # a sample without the values that its message needs
                yield topic, t_ns, to_cdr(made)

    def _made(self, record: CycleRecord) -> Iterator[tuple[str, int, Any]]:
        inputs, state, ros = record.inputs, record.state, self._ros
        if self._frames.follow(record):
            body = Frame(WALL, BODY, *_place(state.pose_body_in_wall))
            start = self._frames.camera_start
            moving = (body,) if start is None else (body, start)
            yield "/tf", state.t_ns, transforms(state.t_ns, moving, ros)
        yield "/clock", record.start_ns, cdr.clock(ros.stamp(record.start_ns))
        for topic, samples, message in self._topics:
            for sample in samples(inputs):
                yield topic, sample.stamp.t_ns, message(sample, ros)
        yield "/odom", state.t_ns, _odometry(state, ros)
        if record.reference is not None:
            place = _place(record.reference.pose_in_wall)
            yield "/reference", inputs.t_ns, ros.pose_stamped(inputs.t_ns, WALL, *place)
        for event in record.events:
            yield "/hil/events", event.t_ns, log(event, ros)
