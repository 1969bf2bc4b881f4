"""The estimate of the emulated computer, and its encoding as an `ODOMETRY` message.

The estimate is kept in robot axes in a levelled world; the message is in front-right-down or front-left-up
axes, depending on the configured frames.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.core.geometry import Three, conjugated, multiplied, rotated
from hil.fakes.tracker.visual_odometry import CameraPose
from hil.links.mavlink.messages import FRAMES, UNKNOWN, UPWARD

_SAME, _HALF_TURN = (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)
_NORTH_OF_EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
_UPPER = np.triu_indices(6)

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Estimate:
    """One estimate, in the frame in which it is sent.

    Attributes:
        time_us: time of the exposure, on the computer's clock.
        frame_id, child_frame_id: numbers of MAV_FRAME.
        position_m, quaternion_wxyz: pose of the camera's body in the first of them.
        velocity_m_s, rates_rad_s: twist in the second.
        pose_covariance, velocity_covariance: 21 numbers, upper triangles by rows.
        resets: number of resets of the estimate, modulo 256.
        quality: percent; -1 failed, 0 unknown.
    """

    time_us: int
    frame_id: int
    child_frame_id: int
    position_m: Numbers
    quaternion_wxyz: Numbers
    velocity_m_s: Numbers
    rates_rad_s: Numbers
    pose_covariance: Numbers
    velocity_covariance: Numbers
    resets: int
    quality: int

    def message(self, common: Any) -> Any:
        """The message, of a MAVLink dialect."""
        return common.MAVLink_odometry_message(
            self.time_us,
            self.frame_id,
            self.child_frame_id,
            *self.position_m,
            list(self.quaternion_wxyz),
            *self.velocity_m_s,
            *self.rates_rad_s,
            list(self.pose_covariance),
            list(self.velocity_covariance),
            self.resets,
            common.MAV_ESTIMATOR_TYPE_VIO,
            self.quality,
        )


def estimate_of(
    pose: CameraPose,
    *,
    time_us: int,
    frame: str,
    twist_in_body: bool,
    pose_sigma: tuple[float, float] | None,
    twist_sigma: tuple[float, float] | None,
    resets: int,
    quality: int,
) -> Estimate:
    """A pose of visual odometry as it is sent.

    Args:
        pose: pose in the axes of the T265, which the emulated visual odometry uses.
        time_us: computer's clock.
        frame: frame of the pose, without MAV_FRAME_.
        twist_in_body: BODY_FRD for the twist, not the pose's frame.
        pose_sigma: standard deviation of position (m) and attitude (rad); None for unknown.
        twist_sigma: standard deviation of velocity (m/s) and rates (rad/s); None for unknown.
        resets: number of resets, as sent.
        quality: quality in percent, as sent.
    """
    *vector_part, scalar_part = pose.rotation_xyzw
    turned = scalar_part, *_in_robot_axes(vector_part)
    velocity, rates = _in_robot_axes(pose.velocity), _in_robot_axes(pose.angular_velocity)
    world = _NORTH_OF_EAST if frame == "LOCAL_ENU" else _SAME if frame in UPWARD else _HALF_TURN
    body = _HALF_TURN if twist_in_body or frame not in UPWARD else _SAME
    sent = multiplied(multiplied(world, turned), conjugated(body))
    twist_turn = multiplied(conjugated(sent), world) if twist_in_body else world
    return Estimate(
        time_us=time_us,
        frame_id=FRAMES[frame],
        child_frame_id=FRAMES["BODY_FRD" if twist_in_body else frame],
        position_m=rotated(world, _in_robot_axes(pose.translation)),
        quaternion_wxyz=sent,
        velocity_m_s=rotated(twist_turn, velocity),
        rates_rad_s=rotated(twist_turn, rates),
        pose_covariance=_triangle(pose_sigma),
        velocity_covariance=_triangle(twist_sigma),
        resets=resets,
        quality=quality,
    )


def _in_robot_axes(camera: Sequence[float]) -> Three:
    """A vector in the T265's axes (right, up, back) in robot axes (forward, left, up)."""
    right, up, back = camera
    return -back, -right, up


def _triangle(sigma: tuple[float, float] | None) -> Numbers:
    """The upper triangle of a covariance without correlations, the same in all axes."""
    if sigma is None:
        return (UNKNOWN,) + (0.0,) * 20
    linear, angular = sigma
    return tuple(np.diag([linear**2] * 3 + [angular**2] * 3)[_UPPER].tolist())
