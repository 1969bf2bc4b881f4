"""Rows of a ROS 2 bag: wheels from `sensor_msgs/JointState`, planar ground truth from pose messages.

Publishers of ros2_control may send drive and steering joints in separate messages. A row is then an instant
of the first drive joint. The other joints are interpolated to it between two of their own messages at most
0.1 s apart. Elsewhere, and where a counter wraps between the two messages, they are NaN.

A quaternion that is no rotation (for example 0 0 0 0 from a system that tracks positions only) is no heading.
A covariance of -1 marks a value as unknown.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools, quat_conjugate, quat_multiply, quat_rotate, yaw_of_quat
from hil.datasets.cleaning import NO_HEADING, UNIT_QUATERNION
from hil.datasets.partial_rows import at_instants
from hil.datasets.topic_map import TruthTopic
from hil.datasets.truth_plane import check_plane

_UNKNOWN = "ground-truth messages left out because a covariance of -1 marks their pose as unknown"
_PLANAR = (0, 7, 35)
"""Indices of the variances of x, y and the turn about z; `_PLANAR_Y_UP`: in a frame whose y axis is up."""
_PLANAR_Y_UP = (0, 14, 28)
_DRIVES = 4


class TruthPoses:
    """Collects the poses of the robot from the messages of one topic.

    Args:
        path: the bag, for messages.
        topic: topic of the poses, with axes and mount of the body.
    """

    def __init__(self, path: Path, topic: TruthTopic) -> None:
        self._path, self._topic = path, topic
        self._y_up = topic.up_axis == "y"
        self._back = quat_conjugate(topic.mount_rotation_wxyz)
        self._known: list[bool] = []
        self._poses: list[list[float]] = []
        self._in_space: list[list[float]] = []
        self._repairs = dict.fromkeys((NO_HEADING, _UNKNOWN), 0)

    def add(self, message: Any) -> None:
        """Add the pose of a message."""
        pose = getattr(message.pose, "pose", message.pose)
        spread = getattr(message.pose, "covariance", None)
        q, at = pose.orientation, pose.position
        lacking = ""
        if spread is not None and any(spread[k] == -1.0 for k in (_PLANAR_Y_UP if self._y_up else _PLANAR)):
            lacking = _UNKNOWN
        elif not UNIT_QUATERNION[0] < q.w**2 + q.x**2 + q.y**2 + q.z**2 < UNIT_QUATERNION[1]:
            lacking = NO_HEADING
        self._known.append(not lacking)
        if lacking:
            self._repairs[lacking] += 1
        else:
            self._poses.append(self._planar((at.x, at.y, at.z), (q.w, q.x, q.y, q.z)))

    def rows(self) -> tuple[Bools, Array, dict[str, int]]:
        """Mask (n,) of messages with a pose, the robot's poses (m, 3), m, m, rad, and counts of repairs.

        Raises:
            DataError: no message holds a heading.
        """
        if self._known and not self._poses:
            raise DataError(
                str(self._path),
                f"{self._topic.topic}: none of {len(self._known)} messages holds a heading (a quaternion "
                "that is a rotation, a covariance that is not -1)",
                expected="poses of a rigid body: odometry cannot be compared with positions alone",
                remedy="let the capture system track a rigid body of three markers, and name its topic",
            )
        poses = np.array(self._poses, dtype=np.float64).reshape(-1, 3)
        in_space = np.array(self._in_space, dtype=np.float64).reshape(-1, 7)
        where = f"{self._path}: {self._topic.topic}"
        check_plane(where, in_space[:, :3], in_space[:, 3:], f'up_axis of [truth] is "{self._topic.up_axis}"')
        left_out = {what: number for what, number in self._repairs.items() if number}
        return np.array(self._known, dtype=np.bool_), poses, left_out

    def _planar(self, at: tuple[float, float, float], q: tuple[float, float, float, float]) -> list[float]:
        if self._y_up:
            at, q = (at[0], -at[2], at[1]), (q[0], q[1], -q[3], q[2])
        turned = quat_multiply(q, self._back)
        x_m, y_m, z_m = np.asarray(at) - quat_rotate(turned, self._topic.mount_position_m)
        self._in_space.append([float(x_m), float(y_m), float(z_m), *map(float, turned)])
        return [float(x_m), float(y_m), yaw_of_quat(turned)]


class JointRows:
    """Collects the joint values of the wheels from the messages of one topic.

    Args:
        path: the bag, for messages.
        topic: topic of the messages.
        names: four drive joints and four steering joints, order FL, BL, BR, FR.
    """

    def __init__(self, path: Path, topic: str, names: Sequence[str]) -> None:
        self._path, self._topic, self._names = path, topic, tuple(names)
        self._rows: list[list[float]] = []
        self._named: list[list[bool]] = []
        self._others: dict[str, None] = {}

    def add(self, message: Any) -> None:
        """Add a message.

        Raises `DataError` where it has fewer positions than joints, unless it has only rates.
        """
        index = {name: i for i, name in enumerate(message.name)}
        named = [name in index for name in self._names]
        self._named.append(named)
        if not all(named):
            self._others.update(dict.fromkeys(index))
        rates_alone = not len(message.position) and len(message.velocity) >= len(index)
        if any(named) and len(message.position) < len(index) and not rates_alone:
            raise DataError(
                str(self._path),
                f"{self._topic} carries {len(message.position)} positions",
                expected="one per joint",
            )
        at = [index.get(name, -1) for name in self._names]
        rates = message.velocity if len(message.velocity) == len(message.name) else ()
        self._rows.append(
            [*(_number(message.position, i) for i in at), *(_number(rates, i) for i in at[:_DRIVES])]
        )

    def rows(self, t_s: Array) -> tuple[Array, Array]:
        """Times (n,) of the rows and (n, 12): angles of drive and steering, rad, and drive rates, rad/s.

        Args:
            t_s: (m,) times of the messages, in the order in which they were added; at least one.

        Raises:
            DataError: no message contains one of the joints.
        """
        named, values = np.array(self._named, dtype=bool), np.array(self._rows, dtype=np.float64)
        missing = [name for k, name in enumerate(self._names) if not named[:, k].any()]
        if missing:
            raise DataError(
                str(self._path),
                f"{self._topic} has no joint {', '.join(missing)}",
                expected=f"some of {', '.join(self._others)}"
                if self._others
                else "messages that name joints",
            )
        first = named[:, 0]
        out = values[first]
        for j in range(len(self._names)):
            if not named[first, j].all():
                own = named[:, j]
                columns = [j, len(self._names) + j] if j < _DRIVES else [j]
                joint = values[own][:, columns]
                if j >= _DRIVES:
                    joint[np.isfinite(joint)] = np.unwrap(joint[np.isfinite(joint)])
                out[:, columns] = at_instants(t_s[first], t_s[own], joint)
        return t_s[first], out


def _number(values: Any, i: int) -> float:
    return float(values[i]) if 0 <= i < len(values) else np.nan
