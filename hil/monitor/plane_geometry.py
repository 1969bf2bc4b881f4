"""Outlines of what the wall view shows; pure geometry, no Rerun.

The view looks at the wall from outside: X (up) points up on the screen, Y (left) to the left. Rerun's
2D views have x to the right and y down, hence `to_view`.
"""

import math

import numpy as np

from hil.core.geometry import Array, rotation2
from hil.robot.kinematics import WheelGeometry

# sqrt of the chi-square quantile 0.95 with two degrees of freedom.
ELLIPSE_SIGMAS = math.sqrt(5.991464547107979)

_BODY_MARGIN_M = 0.04
_ELLIPSE_POINTS = 33
_SPEED_ARROW_S = 1.0


def to_view(points_m: Array) -> Array:
    """Wall coordinates (n, 2) as view coordinates (right, down), m."""
    return np.column_stack([-points_m[:, 1], -points_m[:, 0]])


def place(pose: Array, points_m: Array) -> Array:
    """Body points (n, 2) in the wall frame."""
    return np.asarray(points_m @ rotation2(float(pose[2])).T + pose[:2], dtype=np.float64)


def body_outline(pose: Array, geometry: WheelGeometry) -> Array:
    """Closed outline of the body with a nose towards body x, (7, 2), wall frame, m."""
    half_x = float(np.max(np.abs(geometry.x_m))) + _BODY_MARGIN_M
    half_y = float(np.max(np.abs(geometry.y_m))) + _BODY_MARGIN_M
    corners = [
        (half_x, half_y),
        (-half_x, half_y),
        (-half_x, -half_y),
        (half_x, -half_y),
        (half_x, -0.3 * half_y),
        (1.2 * half_x, 0.0),
        (half_x, 0.3 * half_y),
        (half_x, half_y),
    ]
    return place(pose, np.array(corners))


def wheel_segments(pose: Array, steering_rad: Array, geometry: WheelGeometry) -> Array:
    """The four wheels seen from above as segments along their rolling direction, (4, 2, 2), wall, m.

    Args:
        pose: pose (3,) in the wall frame: m, m, rad.
        steering_rad: steering angles (4,).
        geometry: geometry of the wheels.
    """
    heading = steering_rad - geometry.steering_zero_rad
    along = np.column_stack([np.cos(heading), np.sin(heading)]) * geometry.radius_m[:, None]
    centres = np.column_stack([geometry.x_m, geometry.y_m])
    ends = np.stack([centres - along, centres + along], axis=1)
    return place(pose, ends.reshape(-1, 2)).reshape(4, 2, 2)


def speed_arrows(
    pose: Array, steering_rad: Array, rate_rad_s: Array, geometry: WheelGeometry
) -> tuple[Array, Array]:
    """Origins and vectors (4, 2) of the wheels' speeds, wall frame; one second of travel long.

    Args:
        pose: pose (3,) in the wall frame: m, m, rad.
        steering_rad: steering angles (4,).
        rate_rad_s: (4,) wheel rates.
        geometry: geometry of the wheels.
    """
    heading = steering_rad - geometry.steering_zero_rad
    speed = rate_rad_s * geometry.radius_m * _SPEED_ARROW_S
    vectors = np.column_stack([np.cos(heading), np.sin(heading)]) * speed[:, None]
    origins = place(pose, np.column_stack([geometry.x_m, geometry.y_m]))
    return origins, np.asarray(vectors @ rotation2(float(pose[2])).T, dtype=np.float64)


def covariance_ellipse(pose: Array, covariance: Array) -> Array:
    """Outline of the 95 % ellipse of the position, (33, 2), wall frame, m.

    Args:
        pose: (2,) or (3,) estimated position or pose.
        covariance: covariance (n, n); its first two rows and columns are position in wall axes, m^2.
    """
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    angle = np.linspace(0.0, 2.0 * math.pi, _ELLIPSE_POINTS)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    axes = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(ELLIPSE_SIGMAS * circle @ axes.T + pose[:2], dtype=np.float64)


class Trail:
    """A path that never grows beyond a fixed number of points: it is thinned out by halves.

    Args:
        capacity: points kept at most.
        spacing_m: least distance of a point from the last one; nearer ones are not kept.
    """

    def __init__(self, capacity: int = 600, spacing_m: float = 0.002) -> None:
        self._points: list[tuple[float, float]] = []
        self._capacity, self._spacing_m = capacity, spacing_m

    def add(self, x_m: float, y_m: float) -> None:
        """Take the next point; NaN is left out."""
        if not (math.isfinite(x_m) and math.isfinite(y_m)):
            return
        if self._points and math.dist(self._points[-1], (x_m, y_m)) < self._spacing_m:
            return
        self._points.append((x_m, y_m))
        if len(self._points) > self._capacity:
            self._points = self._points[::2]
            self._spacing_m *= 2.0

    def points(self) -> Array:
        """The path, (n, 2), m."""
        return np.array(self._points, dtype=np.float64).reshape(-1, 2)
