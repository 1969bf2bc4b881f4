"""The ROS 2 messages of a cycle record: samples as their kinds say, estimate, reference, events, frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain

from hil.recording.cdr import TIME, CdrForm, CdrWriter, Doubles
from hil.recording.frames import BODY, CAMERA_START, WALL, Frame, FrameTree
from hil.vocabulary.device import DeviceKind
from hil.vocabulary.geometry import Array
from hil.vocabulary.signals import CycleRecord, Event, RobotState, samples_of

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
_PLANAR = (0, 1, 5, 6, 7, 11, 30, 31, 35)
"""Of a covariance of six (36 numbers), those of x, y and the turn about z."""
_ODOMETRY = CdrForm(
    TIME, WALL, BODY, Doubles(7), Doubles(36, _PLANAR), Doubles(6, (0, 1, 5)), Doubles(36, _PLANAR)
)
_REFERENCE = CdrForm(TIME, WALL, Doubles(7))
_CLOCK = CdrForm(TIME)


def _transform_form(*names: tuple[str, str]) -> CdrForm:
    """Form of a `tf2_msgs/TFMessage`: seven numbers for each frame, which is named after its parent."""
    parts = chain.from_iterable((TIME, parent, child, Doubles(7)) for parent, child in names)
    return CdrForm(len(names), *parts)


_BODY_ALONE = _transform_form((WALL, BODY))
_BODY_AND_CAMERA = _transform_form((WALL, BODY), (WALL, CAMERA_START))


def topics_with(kinds: Sequence[DeviceKind]) -> dict[str, str]:
    """All topics of a recording with their types; those of a kind only if it is among `kinds`."""
    return {**TOPICS, **{topic.name: topic.type for kind in kinds for topic in kind.topics}}


def transforms(t_ns: int, frames: tuple[Frame, ...], wall_ns: int = 0) -> bytes:
    """`tf2_msgs/TFMessage`."""
    form = _transform_form(*((frame.parent, frame.child) for frame in frames))
    return form.pack(t_ns, wall_ns, *map(_spatial_pose, frames))


def _spatial_pose(frame: Frame) -> tuple[float, ...]:
    """Position, and quaternion in the order of ROS."""
    w, x, y, z = frame.quaternion_wxyz
    return (*frame.position_m, x, y, z, w)


def _planar_pose(pose: Array) -> tuple[float, ...]:
    """Position, and quaternion in the order of ROS."""
    x_m, y_m, theta_rad = pose.tolist()
    return x_m, y_m, 0.0, 0.0, 0.0, math.sin(0.5 * theta_rad), math.cos(0.5 * theta_rad)


def _odometry(state: RobotState, place: Sequence[float], wall_ns: int) -> bytes:
    """`nav_msgs/Odometry` of an estimate: pose (7,) in the wall frame, twist in the body frame."""
    x, y, turn, ahead, left, spin = state.covariance.tolist()
    return _ODOMETRY.pack(
        state.t_ns,
        wall_ns,
        place,
        (*x[:3], *y[:3], *turn[:3]),
        state.twist_body.tolist(),
        (*ahead[3:], *left[3:], *spin[3:]),
    )


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


class CycleMessages:
    """ROS 2 messages of the cycles of a recording.

    Args:
        kinds: of the devices whose samples are wanted.
        frames: of the recording; follows its cycles.
        wall_ns: wall-clock time at the bench clock's zero; the messages' own stamps are wall-clock time.
    """

    def __init__(self, kinds: Sequence[DeviceKind], frames: FrameTree, wall_ns: int = 0) -> None:
        self._frames, self._wall_ns = frames, wall_ns
        self._topics = [
            (topic.name, samples_of(kind.name), topic.encode) for kind in kinds for topic in kind.topics
        ]

    def of(self, record: CycleRecord) -> Iterator[Message]:
        """Messages of one cycle, made as they are asked for; cycles come in their order."""
        inputs, state, wall_ns = record.inputs, record.state, self._wall_ns
        place = _planar_pose(state.pose_body_in_wall)
        if self._frames.follow(record):
            yield "/tf", state.t_ns, self._moving(state.t_ns, place)
        yield "/clock", record.start_ns, _CLOCK.pack(record.start_ns, wall_ns)
        for topic, samples, encode in self._topics:
            for sample in samples(inputs):
                yield topic, sample.stamp.t_ns, encode(sample, wall_ns)
        yield "/odom", state.t_ns, _odometry(state, place, wall_ns)
        if record.reference is not None:
            place = _planar_pose(record.reference.pose_in_wall)
            yield "/reference", inputs.t_ns, _REFERENCE.pack(inputs.t_ns, wall_ns, place)
        for event in record.events:
            yield "/hil/events", event.t_ns, log(event, wall_ns)

    def _moving(self, t_ns: int, place: Sequence[float]) -> bytes:
        """`tf2_msgs/TFMessage` of the body's place (7,), and of where the camera began once that is known."""
        start = self._frames.camera_start
        if start is None:
            return _BODY_ALONE.pack(t_ns, self._wall_ns, place)
        return _BODY_AND_CAMERA.pack(t_ns, self._wall_ns, place, _spatial_pose(start))
