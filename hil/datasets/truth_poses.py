"""Planar ground truth from the poses of a topic: axes and mount of the body, and what stands for none.

A quaternion that is no rotation, as the 0 0 0 0 of what tracks positions alone, is no heading. A covariance
of -1 says of a value that it is not known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, quat_conjugate, quat_multiply, quat_rotate, yaw_of_quat
from hil.datasets.topic_map import TruthTopic
from hil.datasets.truth_jumps import Bools

_UNIT = (0.9, 1.1)
"""Square of the length of a quaternion that is a rotation."""
_NO_HEADING = "ground-truth messages whose quaternion is no rotation left out: they hold no heading"
_UNKNOWN = "ground-truth messages whose covariance (-1) says that their pose is not known left out"
_PLANAR = (0, 7, 35)
"""Variances of x, y and the turn about z, or those of the same axes of a frame whose y axis is upwards."""
_PLANAR_Y_UP = (0, 14, 28)


class TruthPoses:
    """What the messages of one topic say of where the robot is.

    Args:
        path: the bag, for messages.
        topic: that they come by, with axes and mount of the body.
    """

    def __init__(self, path: Path, topic: TruthTopic) -> None:
        self._path, self._topic = path, topic
        self._y_up = topic.up_axis == "y"
        self._back = quat_conjugate(topic.mount_rotation_wxyz)
        self._known: list[bool] = []
        self._poses: list[list[float]] = []
        self._repairs = dict.fromkeys((_NO_HEADING, _UNKNOWN), 0)

    def add(self, message: Any) -> None:
        """Take the poses of a message."""
        pose = getattr(message.pose, "pose", message.pose)
        spread = getattr(message.pose, "covariance", None)
        q, at = pose.orientation, pose.position
        lacking = ""
        if spread is not None and any(spread[k] == -1.0 for k in (_PLANAR_Y_UP if self._y_up else _PLANAR)):
            lacking = _UNKNOWN
        elif not _UNIT[0] < q.w**2 + q.x**2 + q.y**2 + q.z**2 < _UNIT[1]:
            lacking = _NO_HEADING
        self._known.append(not lacking)
        if lacking:
            self._repairs[lacking] += 1
        else:
            self._poses.append(self._planar((at.x, at.y, at.z), (q.w, q.x, q.y, q.z)))

    def rows(self) -> tuple[Bools, Array, dict[str, int]]:
        """Which messages (n,) hold a pose, the poses (m, 3) of the robot, m, m, rad, and what was left out.

        Raises:
            DataError: no message holds a heading.
        """
        if self._known and not self._poses:
            raise DataError(
                str(self._path),
                f"{self._topic.topic}: none of {len(self._known)} messages holds a heading (a quaternion "
                "that is a rotation, a covariance that is not -1)",
                expected="poses of a rigid body: odometry is not held against positions alone",
                remedy="let the capture system track a rigid body of three markers, and name its topic",
            )
        poses = np.array(self._poses, dtype=np.float64).reshape(-1, 3)
        left_out = {what: number for what, number in self._repairs.items() if number}
        return np.array(self._known, dtype=np.bool_), poses, left_out

    def _planar(self, at: tuple[float, float, float], q: tuple[float, float, float, float]) -> list[float]:
        if self._y_up:
            at, q = (at[0], -at[2], at[1]), (q[0], q[1], -q[3], q[2])
        turned = quat_multiply(q, self._back)
        x_m, y_m, _ = np.asarray(at) - quat_rotate(turned, self._topic.mount_position_m)
        return [float(x_m), float(y_m), yaw_of_quat(turned)]
