"""IMU and camera of another robot's bag: the samples of their messages, with mounts from numbers or frames.

Covariances are not used: most are constant or zero, and the filters have a noise of their own. One of -1
marks a value as not measured, as the definitions of the messages say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.errors import DataError
from hil.core.geometry import Array, conjugated, multiplied, rotated
from hil.core.signals import ImuSample, Stamp, Status, TrackerSample
from hil.datasets.bag_messages import opened_bag
from hil.datasets.cleaning import UNIT_QUATERNION
from hil.datasets.topic_map import SensorTopic, TopicMap
from hil.loop.alignment import AlignmentParameters
from hil.loop.pose_alignment import Mount
from hil.robot.statics import GRAVITY_M_S2

if TYPE_CHECKING:
    from hil.datasets.wheel_log import Recording

STATIC = "/tf_static"
_BEST = 3
"""Quality of a pose that was tracked."""
_LATEST_S, _SHARED_S = 1.0, 1.0
"""Longest time by which a message may come out of order; shortest time that two sensors share."""
_SETTLES_S, _FIRST_S, _LONGEST_S = 2.0, 0.5, 0.1
"""Time in which the direction of gravity follows the force; first samples that begin it; longest step."""
_ABSENT = -1.0
_NOTHING = (np.nan,) * 3


@dataclass(frozen=True)
class SensorLog:
    """Samples of the sensors on the robot, on the time axis of its wheels, in order of their stamps.

    Attributes:
        imu: samples of the IMU.
        tracker: samples of the camera.
        parameters: mounts and scale, as the control loop applies them.
    """

    imu: tuple[ImuSample, ...] = ()
    tracker: tuple[TrackerSample, ...] = ()
    parameters: AlignmentParameters = field(default_factory=AlignmentParameters)


class ImuRows:
    """Collects the samples of `sensor_msgs/Imu`.

    Args:
        removed: True where the driver has taken gravity out of the accelerations.
    """

    def __init__(self, removed: bool) -> None:
        self._removed = removed
        self._rows: list[list[float]] = []

    def add(self, message: Any) -> None:
        """Add a message."""
        w, x, y, z = _turn(message.orientation)
        if message.orientation_covariance[0] == _ABSENT or not _is_rotation(w, x, y, z):
            w = x = y = z = np.nan
        rate = _vector(message.angular_velocity, message.angular_velocity_covariance)
        force = _vector(message.linear_acceleration, message.linear_acceleration_covariance)
        self._rows.append([*rate, *force, w, x, y, z])

    def samples(self, t_s: Array) -> tuple[ImuSample, ...]:
        """Samples by time; `t_s` (n,) are the times of the messages, s, as they were added."""
        order = np.argsort(t_s, kind="stable")
        t_s, rows = t_s[order], np.array(self._rows, dtype=np.float64)[order]
        rate, force, turn = rows[:, :3], rows[:, 3:6], rows[:, 6:]
        up = _up_by_attitude(turn) if self._removed else _up_by_force(t_s, rate, force)
        linear = force if self._removed else force - up
        usable = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
        return tuple(
            ImuSample(
                _stamp(t, k),
                turn[k],
                rate[k],
                linear[k],
                up[k],
                (),
                Status.OK if usable[k] else Status.NOT_FINITE,
            )
            for k, t in enumerate(t_s.tolist())
        )


class TrackerRows:
    """Collects the poses of a camera, or of another odometry, from pose messages."""

    def __init__(self) -> None:
        self._rows: list[list[float]] = []

    def add(self, message: Any) -> None:
        """Add a message."""
        pose = getattr(message.pose, "pose", message.pose)
        spread = getattr(message.pose, "covariance", (0.0,))
        at, turn = pose.position, _turn(pose.orientation)
        known = spread[0] != _ABSENT and _is_rotation(*turn)
        self._rows.append([at.x, at.y, at.z, *turn] if known else [np.nan] * 7)

    def samples(self, t_s: Array) -> tuple[TrackerSample, ...]:
        """Samples by time; `t_s` (n,) are the times of the messages, s, as they were added."""
        order = np.argsort(t_s, kind="stable")
        rows, unknown = np.array(self._rows, dtype=np.float64)[order], np.array(_NOTHING)
        known = np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)
        return tuple(
            TrackerSample(
                _stamp(t, k),
                rows[k, :3],
                rows[k, 3:],
                unknown,
                unknown,
                _BEST if known[k] else 0,
                Status.OK if known[k] else Status.NOT_TRACKED,
            )
            for k, t in enumerate(t_s[order].tolist())
        )


def sensor_log(
    path: Path, topics: TopicMap, imu: tuple[ImuSample, ...], tracker: tuple[TrackerSample, ...]
) -> SensorLog:
    """Samples with the mounts of the mapping, or of the bag's `/tf_static`.

    Raises:
        DataError: a frame is not in `/tf_static`, or not connected with that of the robot.
    """
    tables = (topics.imu, topics.tracker)
    frames = _transforms(path) if any(table and table.frame for table in tables) else {}
    mounts = [_mount(path, table, topics.body_frame, frames) for table in tables]
    scale = topics.tracker.scale if topics.tracker else 1.0
    parameters = AlignmentParameters(imu=mounts[0], tracker=mounts[1], tracker_scale=scale)
    late_s = [0.0 if table is None or table.latency_s == "fit" else table.latency_s for table in tables]
    return shifted(SensorLog(imu, tracker, parameters), *late_s)


def check_sensor_times(path: Path, wheels: Recording, times: Mapping[str, Array]) -> None:
    """Refuse sensors whose stamps do not fit those of the wheels.

    Args:
        path: the bag, for messages.
        wheels: recording of the wheels.
        times: times of the messages of each topic, on the time axis of the wheels, in their order, s.

    Raises:
        DataError: the stamps step back, or share less than a second with those of the wheels.
    """
    for topic, t_s in times.items():
        back_s = float(np.max(np.maximum.accumulate(t_s) - t_s))
        if wheels.later or back_s > _LATEST_S:
            who = "the wheels" if wheels.later else topic
            raise DataError(
                str(path),
                f"the stamps of {who} step back, and samples of {topic} would lie in two times",
                expected="stamps that go on",
                remedy="cut the bag there",
            )
        begin_s, end_s = float(t_s.min()), float(t_s.max())
        if min(end_s, wheels.t_s[-1]) - max(begin_s, wheels.t_s[0]) < _SHARED_S:
            raise DataError(
                str(path),
                f"{topic} is stamped from {begin_s:.6g} to {end_s:.6g} s after the first message of the bag, "
                f"the wheels from {wheels.t_s[0]:.6g} to {wheels.t_s[-1]:.6g} s",
                expected="stamps of one clock, >= 1 s of both",
                remedy="let the driver stamp its messages by the computer that records them, or leave its "
                "table out",
            )


def shifted(log: SensorLog, imu_s: float, tracker_s: float) -> SensorLog:
    """The samples with stamps that are earlier by the latency of each sensor, s."""
    return replace(
        log,
        imu=tuple(replace(one, stamp=_earlier(one.stamp, imu_s)) for one in log.imu),
        tracker=tuple(replace(one, stamp=_earlier(one.stamp, tracker_s)) for one in log.tracker),
    )


def between(samples: Sequence[Any], edges_s: Array) -> Iterator[Sequence[Any]]:
    """Samples since each edge before, up to each edge (n,); first those at the first edge itself."""
    stamps_ns = [one.stamp.t_ns for one in samples]
    edges_ns = [nanoseconds(t) for t in edges_s.tolist()]
    ends = np.searchsorted(stamps_ns, edges_ns, side="right").tolist()
    begin = int(np.searchsorted(stamps_ns, edges_ns[:1], side="left")[0])
    for end in ends:
        yield samples[begin:end]
        begin = end


def _earlier(stamp: Stamp, by_s: float) -> Stamp:
    t_ns = stamp.t_ns - nanoseconds(by_s)
    return replace(stamp, t_ns=t_ns, host_ns=t_ns)


def _stamp(t_s: float, number: int) -> Stamp:
    t_ns = nanoseconds(t_s)
    return Stamp(t_ns, t_ns, number)


def _turn(q: Any) -> tuple[float, float, float, float]:
    return q.w, q.x, q.y, q.z


def _is_rotation(w: float, x: float, y: float, z: float) -> bool:
    return UNIT_QUATERNION[0] < w * w + x * x + y * y + z * z < UNIT_QUATERNION[1]


def _vector(values: Any, covariance: Any) -> tuple[float, float, float]:
    return _NOTHING if covariance[0] == _ABSENT else (values.x, values.y, values.z)


def _up_by_attitude(turn: Array) -> Array:
    """Gravity (n, 3), upwards, in the sensor's frame by its own attitude (n, 4)."""
    upwards = (0.0, 0.0, GRAVITY_M_S2)
    return np.array([rotated(conjugated(q), upwards) for q in turn.tolist()]).reshape(-1, 3)


def _up_by_force(t_s: Array, rate: Array, force: Array) -> Array:
    """Gravity (n, 3), upwards: turned by the rates, and drawn to the force within two seconds."""
    known = np.asarray(np.isfinite(force).all(axis=1), dtype=np.bool_)
    first = known & (t_s <= t_s[0] + _FIRST_S)
    out = np.full((len(t_s), 3), np.nan)
    if not first.any():
        return out
    up = force[first].mean(axis=0).tolist()
    rates, forces = np.nan_to_num(rate).tolist(), force.tolist()
    steps = np.clip(np.diff(t_s, prepend=t_s[0]), 0.0, _LONGEST_S).tolist()
    for k, dt in enumerate(steps):
        (a, b, c), (x, y, z) = rates[k], up
        up = [x - dt * (b * z - c * y), y - dt * (c * x - a * z), z - dt * (a * y - b * x)]
        if known[k]:
            share = dt / _SETTLES_S
            up = [u + share * (f - u) for u, f in zip(up, forces[k], strict=True)]
        out[k] = up
    return out


_Pose = tuple[tuple[float, ...], tuple[float, ...]]
"""Position, m, and quaternion wxyz."""


def _transforms(path: Path) -> dict[str, tuple[str, _Pose]]:
    """Parent of each frame of `/tf_static`, and its pose in the parent."""
    found: dict[str, tuple[str, _Pose]] = {}
    with opened_bag(path) as bag:
        for _, _, message in bag.messages((STATIC,)):
            for one in message.transforms:
                at = one.transform.translation
                pose: _Pose = ((at.x, at.y, at.z), _turn(one.transform.rotation))
                found[one.child_frame_id] = (one.header.frame_id, pose)
    return found


def _mount(path: Path, table: SensorTopic | None, body: str, frames: dict[str, tuple[str, _Pose]]) -> Mount:
    """Mount of a sensor on the robot: by numbers, or by its frame."""
    if table is None:
        return Mount()
    if table.frame is None:
        return Mount(table.mount_position_m, table.mount_rotation_wxyz)
    ways = [_above(frame, frames) for frame in (body, table.frame)]
    if ways[0][0] != ways[1][0] or not frames:
        there = ", ".join(sorted({*frames, *(parent for parent, _ in frames.values())}))
        raise DataError(
            str(path),
            f"{STATIC} does not connect {table.frame} with {body}",
            expected=f"some of {there}" if there else "transforms of the sensors",
            remedy="name frames that it connects in frame and body_frame, or give the mount in numbers",
        )
    (_, (p0, q0)), (_, (p1, q1)) = ways
    back = conjugated(q0)
    x, y, z = rotated(back, [b - a for a, b in zip(p0, p1, strict=True)])
    return Mount((x, y, z), multiplied(back, q1))


def _above(frame: str, frames: dict[str, tuple[str, _Pose]]) -> tuple[str, _Pose]:
    """Root of the tree of a frame, and the frame's pose in it."""
    place, turn = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    for _ in frames:
        if frame not in frames:
            break
        frame, (at, q) = frames[frame]
        x, y, z = rotated(q, place)
        place, turn = (at[0] + x, at[1] + y, at[2] + z), multiplied(q, turn)
    return frame, (place, turn)
