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
from hil.recording.rosbags_adapter import MessageMaker, pose_numbers, to_cdr
from hil.recording.transform_tree import BODY, WALL, Frame, FrameTree

Message = tuple[str, int, bytes]
"""Topic, time of measurement (bench clock, ns), CDR bytes."""

_LOG_LEVEL = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}
_BODY = WALL, BODY
_NONE3, _NONE18 = (0.0,) * 3, (0.0,) * 18


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


def _of_six(planar: Array) -> tuple[float, ...]:
    """Covariance (36,) of a pose or twist in space from that of x, y and rotation about z, (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = planar.tolist()
    return (a, b, *_NONE3, c, d, e, *_NONE3, f, *_NONE18, g, h, *_NONE3, i)


def _odometry(state: RobotState, ros: MessageMaker) -> bytes | None:
    """`nav_msgs/Odometry` of an estimate: pose in the wall frame, twist in the body frame."""
    forward, left, spin = state.twist_body.tolist()
    pose = (*pose_numbers(*_place(state.pose_body_in_wall)), *_of_six(state.covariance[:3, :3]))
    twist = (forward, left, 0.0, 0.0, 0.0, spin, *_of_six(state.covariance[3:, 3:]))
    return ros.numbers(state.t_ns, _BODY, (*pose, *twist))


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
        inputs, state, ros = record.inputs, record.state, self._ros
        if self._frames.follow(record):
            moving, start = (
                [(_BODY, pose_numbers(*_place(state.pose_body_in_wall)))],
                self._frames.camera_start,
            )
            if start is not None:
                names = start.parent, start.child
                moving.append((names, pose_numbers(start.position_m, start.quaternion_wxyz)))
            yield "/tf", state.t_ns, cdr.transforms(ros.stamp(state.t_ns), moving)
        yield "/clock", record.start_ns, cdr.clock(ros.stamp(record.start_ns))
        for topic, samples, message in self._topics:
            for sample in samples(inputs):
                made = message(sample, ros)
                if made is not None:  # a sample without the values that its message needs
                    yield topic, sample.stamp.t_ns, to_cdr(made)
        odometry = _odometry(state, ros)
        if odometry is not None:
            yield "/odom", state.t_ns, odometry
        if record.reference is not None:
            place = _place(record.reference.pose_in_wall)
            pose = ros.pose_stamped(inputs.t_ns, WALL, *place)
            if pose is not None:
                yield "/reference", inputs.t_ns, pose
        for event in record.events:
            yield "/hil/events", event.t_ns, to_cdr(log(event, ros))
