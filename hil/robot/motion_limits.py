"""Whether a robot can follow a trajectory: checked before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.robot.trajectories import Trajectory
from hil.vocabulary.errors import TrajectoryError
from hil.vocabulary.geometry import Array, rotation2

_CHECK_STEP_S = 0.01
_LONGEST_S = 7200.0
_SLACK = 1.0 + 1e-6


@dataclass(frozen=True)
class MotionLimits:
    """What a reference is held against before anything moves.

    Attributes:
        wheel_speed_m_s, wheel_acceleration_m_s2: per wheel.
        heading_limit_rad: of the heading while on a wall, None on the floor.
        x_range_m, y_range_m: the usable wall, None for no bound.
    """

    wheel_speed_m_s: float = 0.122
    wheel_acceleration_m_s2: float = 0.2
    heading_limit_rad: float | None = None
    x_range_m: tuple[float, float] | None = None
    y_range_m: tuple[float, float] | None = None


def check(trajectory: Trajectory, projection: Array, limits: MotionLimits) -> None:
    """Refuse a trajectory that the limits cannot follow.

    Args:
        trajectory: what is asked for.
        projection: P (8, 3) of the wheels, `WheelGeometry.projection()`.
        limits: what must hold at every time.

    Raises:
        TrajectoryError: with the first offending time and value.
    """
    if not trajectory.duration_s <= _LONGEST_S:
        raise TrajectoryError(
            trajectory.name, t_s=0.0, quantity="duration (s)", value=trajectory.duration_s, limit=_LONGEST_S,
            remedy="divide the motion",
        )  # fmt: skip
    steps = np.arange(0.0, trajectory.duration_s + _CHECK_STEP_S, _CHECK_STEP_S)
    for t_s in steps.tolist():
        now = trajectory.sample(t_s)
        if not (np.all(np.isfinite(now.pose_in_wall)) and np.all(np.isfinite(now.twist_body))):
            raise TrajectoryError(
                trajectory.name, t_s=t_s, quantity="reference", value=math.nan, limit=math.inf
            )
        speed = np.hypot(*(projection @ now.twist_body).reshape(4, 2).T)
        _hold(trajectory, t_s, "wheel speed (m/s)", float(speed.max()), limits.wheel_speed_m_s)
        body = rotation2(-float(now.pose_in_wall[2])) @ now.acceleration_wall[:2]
        pull = np.hypot(
            *(projection @ np.array([body[0], body[1], now.acceleration_wall[2]])).reshape(4, 2).T
        )
        _hold(
            trajectory, t_s, "wheel acceleration (m/s^2)", float(pull.max()), limits.wheel_acceleration_m_s2
        )
        if limits.heading_limit_rad is not None:
            heading = abs(float(now.pose_in_wall[2]))
            _hold(trajectory, t_s, "heading on the wall (rad)", heading, limits.heading_limit_rad)
        for axis, bounds in enumerate((limits.x_range_m, limits.y_range_m)):
            if bounds is not None:
                value = float(now.pose_in_wall[axis])
                label = f"{'xy'[axis]} on the wall (m)"
                _hold(trajectory, t_s, label, value, bounds[1])
                _hold(trajectory, t_s, "-" + label, -value, -bounds[0])


def _hold(trajectory: Trajectory, t_s: float, quantity: str, value: float, limit: float) -> None:
    if not value <= limit + abs(limit) * (_SLACK - 1.0) + 1e-12:
        raise TrajectoryError(trajectory.name, t_s=t_s, quantity=quantity, value=value, limit=limit)
