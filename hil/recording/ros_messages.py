"""ROS 2 messages of a cycle record, serialised as CDR without ROS.

Written by hand because a general serialiser costs 26 us per message and these
run beside a control loop; the tests hold every byte against `rosbags`. Layout: OMG DDS-XTypes plain
CDR, little endian, primitives aligned to their size counted from after the four header bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from hil.recording.frames import BODY, CAMERA_START, CAPTURE, IMU, WALL, Frame
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.geometry import Array, quat_from_yaw
from hil.vocabulary.signals import (
    SERVOS,
    CycleRecord,
    EncoderSample,
    Event,
    ImuSample,
    Reference,
    RobotState,
    ServoSample,
)

TOPICS = {
    "/hil/cycle": "std_msgs/msg/UInt8MultiArray",
    "/hil/notes": "std_msgs/msg/String",
    "/hil/events": "rcl_interfaces/msg/Log",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/steering_encoders": "sensor_msgs/msg/JointState",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/reference": "geometry_msgs/msg/PoseStamped",
    "/tracker/pose": "geometry_msgs/msg/PoseStamped",
    "/mocap/pose": "geometry_msgs/msg/PoseStamped",
}

_HEADER = b"\x00\x01\x00\x00"
_U32, _TIME = struct.Struct("<I"), struct.Struct("<iI")
_MAX_SECONDS = 2**31 - 1
_LOG_LEVEL = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}
_PLANAR = (0, 1, 5)
_NO_COVARIANCE = bytes(9 * 8)
_NOTHING = np.empty(0)
_SEVEN = struct.Struct("<7d")


class CdrWriter:
    """Appends values with CDR alignment.

    Args:
        wall_ns: wall-clock time at the zero of the times that are written.
    """

    def __init__(self, wall_ns: int = 0) -> None:
        self._out = bytearray(_HEADER)
        self._wall_ns = wall_ns

    def align(self, size: int) -> None:
        """Pad to a multiple of `size`, counted from after the header."""
        self._out += bytes((4 - len(self._out)) % size)

    def u8(self, value: int) -> None:
        """One byte."""
        self._out.append(value)

    def u32(self, value: int) -> None:
        """Unsigned, four bytes."""
        self.align(4)
        self._out += _U32.pack(value)

    def time(self, t_ns: int) -> None:
        """`builtin_interfaces/Time` of a time on the bench clock; clipped to what 32-bit seconds can say."""
        self.align(4)
        seconds, nanoseconds = divmod(max(0, t_ns + self._wall_ns), NS_PER_S)
        self._out += _TIME.pack(min(seconds, _MAX_SECONDS), nanoseconds)

    def text(self, value: str) -> None:
        """String with its terminating zero."""
        raw = value.encode("utf-8", "replace")
        self.u32(len(raw) + 1)
        self._out += raw
        self._out += b"\0"

    def header(self, t_ns: int, frame: str) -> None:
        """`std_msgs/Header`."""
        self.time(t_ns)
        self.text(frame)

    def doubles(self, *groups: bytes) -> None:
        """Fixed-size doubles given as their bytes."""
        self.align(8)
        for raw in groups:
            self._out += raw

    def sequence(self, values: Array) -> None:
        """`float64[]`."""
        self.u32(len(values))
        if len(values):
            self.doubles(_raw(values))

    def octets(self, raw: bytes) -> None:
        """`uint8[]`."""
        self.u32(len(raw))
        self._out += raw

    def bytes(self) -> bytes:
        """The message."""
        return bytes(self._out)


def _raw(values: Array) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def _xyzw(q_wxyz: Array) -> bytes:
    return _raw(np.roll(q_wxyz, -1))


def octet_array(payload: bytes) -> bytes:
    """`std_msgs/UInt8MultiArray` with one unnamed dimension left out."""
    cdr = CdrWriter()
    cdr.u32(0)
    cdr.u32(0)
    cdr.octets(payload)
    return cdr.bytes()


def octets_of(message: bytes) -> bytes:
    """Payload of a message made by `octet_array`.

    Raises:
        ValueError: another layout, or shorter than it says.
    """
    if len(message) < 16 or message[:4] != _HEADER or any(message[4:8]):
        raise ValueError("not a byte array as written by this project")
    payload = message[16 : 16 + _U32.unpack_from(message, 12)[0]]
    if len(payload) != _U32.unpack_from(message, 12)[0]:
        raise ValueError("byte array shorter than it says")
    return payload


def string(value: str) -> bytes:
    """`std_msgs/String`."""
    cdr = CdrWriter()
    cdr.text(value)
    return cdr.bytes()


def text_of(message: bytes) -> str:
    """Text of a `std_msgs/String`.

    Raises:
        ValueError: shorter than it says.
    """
    if len(message) < 9:
        raise ValueError("string message too short")
    length = _U32.unpack_from(message, 4)[0]
    if length < 1 or len(message) < 8 + length:
        raise ValueError("string shorter than it says")
    return message[8 : 7 + length].decode("utf-8", "replace")


def joint_state(sample: ServoSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/JointState` of the servos' own angles; effort holds the current in A."""
    values = (sample.position_rad, sample.velocity_rad_s, sample.current_a)
    return _joints(sample.stamp.t_ns, SERVOS, values, wall_ns)


def encoder_state(sample: EncoderSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/JointState` of the external encoders' own angles, NaN where one cannot be used."""
    return _joints(sample.stamp.t_ns, SERVOS[4:], (sample.angle_rad, _NOTHING, _NOTHING), wall_ns)


def _joints(t_ns: int, names: tuple[str, ...], values: tuple[Array, ...], wall_ns: int) -> bytes:
    cdr = CdrWriter(wall_ns)
    cdr.header(t_ns, "")
    cdr.u32(len(names))
    for name in names:
        cdr.text(name)
    for column in values:
        cdr.sequence(column)
    return cdr.bytes()


def transforms(t_ns: int, frames: tuple[Frame, ...], wall_ns: int = 0) -> bytes:
    """`tf2_msgs/TFMessage`."""
    cdr = CdrWriter(wall_ns)
    cdr.u32(len(frames))
    for frame in frames:
        cdr.header(t_ns, frame.parent)
        cdr.text(frame.child)
        w, *xyz = frame.quaternion_wxyz
        cdr.doubles(_SEVEN.pack(*frame.position_m, *xyz, w))
    return cdr.bytes()


def imu(sample: ImuSample, wall_ns: int = 0) -> bytes:
    """`sensor_msgs/Imu`; acceleration with gravity (specific force), as REP 145 asks."""
    cdr = CdrWriter(wall_ns)
    cdr.header(sample.stamp.t_ns, IMU)
    force = np.asarray(sample.linear_acceleration_m_s2) + np.asarray(sample.gravity_m_s2)
    cdr.doubles(
        _xyzw(sample.quaternion_wxyz), _NO_COVARIANCE,
        _raw(sample.gyro_rad_s), _NO_COVARIANCE,
        _raw(force), _NO_COVARIANCE,
    )  # fmt: skip
    return cdr.bytes()


def _planar_pose(pose: Array) -> tuple[bytes, bytes]:
    return _raw(np.array([pose[0], pose[1], 0.0])), _xyzw(quat_from_yaw(float(pose[2])))


def _spatial_covariance(planar: Array) -> bytes:
    spatial = np.zeros((6, 6))
    spatial[np.ix_(_PLANAR, _PLANAR)] = planar
    return _raw(spatial)


def odometry(state: RobotState, wall_ns: int = 0) -> bytes:
    """`nav_msgs/Odometry` of an estimate: pose in the wall frame, twist in the body frame."""
    cdr = CdrWriter(wall_ns)
    cdr.header(state.t_ns, WALL)
    cdr.text(BODY)
    v_x, v_y, omega = state.twist_body
    cdr.doubles(
        *_planar_pose(state.pose_body_in_wall),
        _spatial_covariance(state.covariance[:3, :3]),
        _raw(np.array([v_x, v_y, 0.0, 0.0, 0.0, omega])),
        _spatial_covariance(state.covariance[3:6, 3:6]),
    )
    return cdr.bytes()


def pose_stamped(t_ns: int, frame: str, position_m: Array, quaternion_wxyz: Array, wall_ns: int = 0) -> bytes:
    """`geometry_msgs/PoseStamped`."""
    cdr = CdrWriter(wall_ns)
    cdr.header(t_ns, frame)
    cdr.doubles(_raw(position_m), _xyzw(quaternion_wxyz))
    return cdr.bytes()


def _reference(t_ns: int, reference: Reference, wall_ns: int) -> bytes:
    cdr = CdrWriter(wall_ns)
    cdr.header(t_ns, WALL)
    cdr.doubles(*_planar_pose(reference.pose_in_wall))
    return cdr.bytes()


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


def messages(record: CycleRecord, wall_ns: int = 0) -> Iterator[tuple[str, int, bytes]]:
    """ROS 2 messages of one cycle: topic, time of measurement (bench clock, ns), CDR bytes.

    Args:
        record: the cycle.
        wall_ns: wall-clock time at the bench clock's zero; the messages' own stamps are wall-clock time.
    """
    inputs = record.inputs
    for servos in inputs.servos:
        yield "/joint_states", servos.stamp.t_ns, joint_state(servos, wall_ns)
    for encoders in inputs.encoders:
        yield "/steering_encoders", encoders.stamp.t_ns, encoder_state(encoders, wall_ns)
    for sample in inputs.imu:
        yield "/imu/data", sample.stamp.t_ns, imu(sample, wall_ns)
    for topic, frame, poses in (
        ("/tracker/pose", CAMERA_START, inputs.tracker),
        ("/mocap/pose", CAPTURE, inputs.mocap),
    ):
        for pose in poses:
            t_ns = pose.stamp.t_ns
            yield topic, t_ns, pose_stamped(t_ns, frame, pose.position_m, pose.quaternion_wxyz, wall_ns)
    yield "/odom", record.state.t_ns, odometry(record.state, wall_ns)
    if record.reference is not None:
        yield "/reference", inputs.t_ns, _reference(inputs.t_ns, record.reference, wall_ns)
    for event in record.events:
        yield "/hil/events", event.t_ns, log(event, wall_ns)
