"""Geometry of the three-dimensional view: positions, rotations and arrows; pure numpy, no Rerun.

Frames, each child of the one before: `scene` has z against gravity; `wall` is the wall frame (X up the
wall, Y left, Z out of it), tilted about the horizontal Y; `body`; a wheel's hub at the wheel's centre,
steered about z; the wheel, turned about its axle.
"""

import math
from typing import NamedTuple

import numpy as np

from hil.core.geometry import Array, multiplied, quat_from_rotvec, quat_from_yaw, quat_rotate, rotation2
from hil.monitor.plane_geometry import covariance_ellipse
from hil.robot.kinematics import WheelGeometry

ARROW_M_PER_N = 0.004
ARROW_S = 20.0
"""Lengths of arrows: of a force, and of a slip velocity (m for each m/s)."""

_LOAD_OUTSIDE = 1.35
_ELLIPSE_HEIGHT_M = 0.13
_EYE_FROM = np.array([-0.55, -0.6, 1.35])
_EYE_M, _EYE_PER_HEIGHT, _EYE_PER_WIDTH = 0.15, 0.75, 0.62
_NEAR_M = 0.8


def wall_rotation(tilt_rad: float) -> Array:
    """(3, 3) from wall to scene: wall X points up at pi/2, ahead at 0; Y is level and points left."""
    c, s = math.cos(tilt_rad), math.sin(tilt_rad)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def translation(pose: Array) -> Array:
    """Position (3,) of a pose in the wall frame, on the surface, m."""
    return np.array([pose[0], pose[1], 0.0])


def hub_places(geometry: WheelGeometry) -> Array:
    """Centres of the wheels in the body, (4, 3), m."""
    return np.column_stack([geometry.x_m, geometry.y_m, geometry.radius_m])


def hub_turns(steering_rad: Array, geometry: WheelGeometry) -> Array:
    """Quaternions (4, 4) wxyz from hub to body at measured steering angles (4,)."""
    return np.stack([quat_from_yaw(a) for a in steering_rad - geometry.steering_zero_rad])


def wheel_turns(steering_rad: Array, wheel_angle_rad: Array, geometry: WheelGeometry) -> Array:
    """Quaternions (4, 4) wxyz from wheel to body: steered, then turned about the axle (y of the hub).

    Args:
        steering_rad: measured steering angles (4,).
        wheel_angle_rad: wheel angles (4,); positive drives ahead.
        geometry: geometry of the wheels.
    """
    turned = [quat_from_rotvec([0.0, a, 0.0]).tolist() for a in np.remainder(wheel_angle_rad, 2.0 * math.pi)]
    steered = hub_turns(steering_rad, geometry)
    return np.array([multiplied(s, t) for s, t in zip(steered.tolist(), turned, strict=True)])


def in_body(vectors: Array, steering_rad: Array, geometry: WheelGeometry) -> Array:
    """Vectors (4, 2) from the wheels' frames (along, across) to the body frame, (4, 2)."""
    heading = steering_rad - geometry.steering_zero_rad
    c, s = np.cos(heading), np.sin(heading)
    along, across = vectors[:, 0], vectors[:, 1]
    return np.column_stack([c * along - s * across, s * along + c * across])


def slip_of_motion(
    twist_body: Array, rate_rad_s: Array, steering_rad: Array, geometry: WheelGeometry
) -> Array:
    """Slip velocities (4, 2) of the contacts over the surface, along and across each wheel, m/s.

    Motion of the contact minus rolling of the wheel; the emulated robot's truth uses the same definition.

    Args:
        twist_body: (3,) true body twist.
        rate_rad_s: (4,) wheel rates.
        steering_rad: (4,) measured.
        geometry: geometry of the wheels.
    """
    velocity = (geometry.projection() @ twist_body).reshape(4, 2)
    heading = steering_rad - geometry.steering_zero_rad
    c, s = np.cos(heading), np.sin(heading)
    along = c * velocity[:, 0] + s * velocity[:, 1] - rate_rad_s * geometry.radius_m
    return np.column_stack([along, c * velocity[:, 1] - s * velocity[:, 0]])


def slip_arrows(slip_m_s: Array, steering_rad: Array, geometry: WheelGeometry) -> tuple[Array, Array]:
    """Origins and vectors (4, 3) in the body of slip velocities (4, 2), `ARROW_S` seconds long."""
    origins = np.column_stack([geometry.x_m, geometry.y_m, 2.2 * geometry.radius_m])
    vectors = np.zeros((4, 3))
    vectors[:, :2] = ARROW_S * in_body(slip_m_s, steering_rad, geometry)
    return origins, vectors


def load_arrows(load_n: Array, geometry: WheelGeometry) -> tuple[Array, Array]:
    """Origins and vectors (4, 3) in the body of normal loads (4,): out of the surface, beside each wheel."""
    origins = np.column_stack([_LOAD_OUTSIDE * geometry.x_m, _LOAD_OUTSIDE * geometry.y_m, np.zeros(4)])
    vectors = np.zeros((4, 3))
    vectors[:, 2] = ARROW_M_PER_N * load_n
    return origins, vectors


def ellipse_in_body(covariance: Array, heading_rad: float) -> Array:
    """Outline of the 95 % ellipse of the position, (33, 3), in the body, above the robot, m.

    Args:
        covariance: covariance (n, n); its first two rows and columns are position in wall axes, m^2.
        heading_rad: heading of the body.
    """
    flat = covariance_ellipse(np.zeros(2), covariance) @ rotation2(heading_rad)
    return np.column_stack([flat, np.full(len(flat), _ELLIPSE_HEIGHT_M)])


def gravity_in_body(tilt_rad: float, heading_rad: float) -> Array:
    """Unit vector (3,) of gravity in the body."""
    down = wall_rotation(tilt_rad).T @ np.array([0.0, 0.0, -1.0])
    return quat_rotate(quat_from_yaw(-heading_rad), down)


class Eye(NamedTuple):
    """A camera of the view: its position, the point that it looks at, and the direction up, (3,) each, m."""

    place: Array
    target: Array
    up: Array


def overview(low_m: Array, high_m: Array, tilt_rad: float) -> Eye:
    """Camera for a view of a part of the surface, scene frame.

    From outside, a little below and to the right of the middle, so that depth can be seen.

    Args:
        low_m: (2,) lower corner of the part, wall frame.
        high_m: (2,) upper corner.
        tilt_rad: tilt of the surface.
    """
    rotation = wall_rotation(tilt_rad)
    target = np.array([*((low_m + high_m) / 2.0), 0.0])
    height_m, width_m = (high_m - low_m).tolist()
    reach_m = _EYE_M + max(_EYE_PER_HEIGHT * height_m, _EYE_PER_WIDTH * width_m)
    place = target + reach_m * _EYE_FROM / np.linalg.norm(_EYE_FROM)
    return Eye(rotation @ place, rotation @ target, np.array([0.0, 0.0, 1.0]))


def beside(tilt_rad: float) -> Eye:
    """Camera close behind the robot, in its body; upright when the robot points up the surface."""
    place = _NEAR_M * _EYE_FROM / np.linalg.norm(_EYE_FROM)
    return Eye(place, np.array([0.0, 0.0, 0.04]), -gravity_in_body(tilt_rad, 0.0))
