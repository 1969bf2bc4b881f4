"""Visual odometry of the emulated camera: true body poses in, erring camera poses out.

The pose is kept in a levelled world (x where the camera looked at the start, z against gravity) and
given out in the T265's axes, where that world is x right, y up, z back. On a wall gravity lies in the
motion plane, so the drift about gravity tilts the path out of the wall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.core.geometry import (
    Array,
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
)
from hil.fakes.body_interface import BodyMotion
from hil.fakes.tracker.camera_truth import TrackerTruthOptions
from hil.fakes.tracker.odometry_step import DRAWS, LAST_X, LAST_Y, POSITION, STATE_SIZE, WORLD_SIZE, Way, step
from hil.support.numba_jit import compile_for, plain

_BLOCK = 512
_NEAR_VERTICAL = 0.2


class Vector(NamedTuple):
    """Three components, as `rs.vector`."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """Four components, as `rs.quaternion`."""

    x: float
    y: float
    z: float
    w: float


class CameraPose(NamedTuple):
    """One pose in the T265's axes: m, m/s, quaternion, rad/s."""

    translation: Vector
    velocity: Vector
    rotation_xyzw: Quaternion
    angular_velocity: Vector


def camera_axes(x: float, y: float, z: float) -> Vector:
    """A vector in robot axes (forward, left, up) in the camera's axes (right, up, back)."""
    return Vector(-y, z, -x)


class VisualOdometry:
    """Follows one camera on the body.

    Args:
        options: true imperfections.
        rng: random stream of the device.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body, as it truly is.
    """

    def __init__(
        self,
        options: TrackerTruthOptions,
        rng: np.random.Generator,
        *,
        mount_position_m: tuple[float, float, float],
        mount_rotation_wxyz: tuple[float, float, float, float],
    ) -> None:
        self._options, self._rng = options, rng
        self._mount_m, self._mount_wxyz = mount_position_m, mount_rotation_wxyz
        self.scale = options.scale + options.scale_sigma * float(rng.standard_normal())
        if options.session_scale_sigma > 0.0:
            session = np.random.default_rng((options.session, int(self.scale * 1e12)))
            self.scale += options.session_scale_sigma * float(session.standard_normal())
        yaw_rate_rad_s = options.yaw_rate_sigma_rad_s * float(rng.standard_normal())
        self._errors = np.array(
            (
                yaw_rate_rad_s,
                options.yaw_walk_rad_sqrt_s,
                options.position_walk_m_sqrt_m,
                options.position_noise_m,
                options.velocity_noise_m_s,
                options.rate_noise_rad_s,
                options.angle_noise_rad,
            )
        )
        self._world, self._state = np.zeros(WORLD_SIZE), np.zeros(STATE_SIZE)
        self._draws, self._row = np.zeros((1, DRAWS)), 0
        compile_for(step, plain(Way()), self._draws, 0, self._errors, self._world, self._state)
        self._started = False

    def restart(self) -> None:
        """Lose the map: the next pose is the origin of a new world."""
        self._started = False

    def jump(self, distance_m: float) -> None:
        """Correct the position at once, as a relocalisation does: translation only."""
        direction = self._rng.standard_normal(3)
        way = distance_m * direction / float(np.linalg.norm(direction))
        for k, by_m in enumerate(way.tolist()):
            self._state[POSITION + k] += by_m

    def drift(self, x_m: float, y_m: float) -> None:
        """See a way in the wall's axes that the camera has not gone, together with the next step."""
        if self._started:
            self._state[LAST_X] -= x_m
            self._state[LAST_Y] -= y_m

    def rate_rad_s(self, omega_rad_s: float) -> Array:
        """The camera's rate of turn in its own axes (3,)."""
        return self._in_camera([0.0, 0.0, omega_rad_s])

    def _in_camera(self, in_body: list[float]) -> Array:
        return np.array(camera_axes(*quat_rotate(quat_conjugate(self._mount_wxyz), in_body)))

    def _in_wall(self, in_camera: Array, theta_rad: float) -> tuple[float, float]:
        """A vector in the camera's axes along wall x and y."""
        right, up, back = in_camera
        x, y, _ = quat_rotate(self._mount_wxyz, [-back, -right, up])
        c, s = math.cos(theta_rad), math.sin(theta_rad)
        return c * x - s * y, s * x + c * y

    def observe(
        self, body: BodyMotion, dt_s: float, scale: float = 1.0, by_wheels: tuple[Array, float] | None = None
    ) -> CameraPose:
        """The camera's pose for the body's true motion, `dt_s` after the last one.

        Args:
            body: its true motion.
            dt_s: since the last pose.
            scale: factor on what is seen.
            by_wheels: velocity (2,), camera axes, m/s, as the wheels tell it; its weight beside what is seen.
        """
        x, y, theta, vx, vy, omega, _, _, tilt = body
        c, s = math.cos(theta), math.sin(theta)
        mx, my, _ = self._mount_m
        arm_x, arm_y = c * mx - s * my, s * mx + c * my
        wall_x, wall_y = x + arm_x, y + arm_y
        along, left = c * vx - s * vy - omega * arm_y, s * vx + c * vy + omega * arm_x
        if not self._started:
            self._start(theta, tilt, (wall_x, wall_y))
        wheel_x = wheel_y = weight = 0.0
        if by_wheels is not None:
            wheels, weight = by_wheels
            u, v = self._in_wall(wheels, theta)
            wheel_x, wheel_y = u * dt_s, v * dt_s
        if not self._row:
            self._draws, self._row = self._rng.standard_normal((_BLOCK, DRAWS)), _BLOCK
        self._row -= 1
        way = Way(
            theta,
            omega,
            wall_x,
            wall_y,
            along,
            left,
            math.hypot(along, left),
            dt_s,
            scale * self.scale,
            wheel_x,
            wheel_y,
            weight,
        )
        reported = step(plain(way), self._draws, self._row, self._errors, self._world, self._state)
        position, velocity = Vector(*reported[:3]), Vector(*reported[3:6])
        rotation, rate = Quaternion(*reported[6:10]), Vector(*reported[10:])
        return CameraPose(position, velocity, rotation, rate)

    def _start(self, theta_rad: float, tilt_rad: float, in_wall: tuple[float, float]) -> None:
        """Fix the levelled world by gravity and the direction the camera looks."""
        level = quat_from_rotvec([0.0, -tilt_rad, 0.0])
        body = quat_multiply(level, quat_from_yaw(theta_rad))
        forward = quat_rotate(quat_multiply(body, self._mount_wxyz), [1.0, 0.0, 0.0])
        heading = math.atan2(forward[1], forward[0])
        if math.hypot(forward[0], forward[1]) < _NEAR_VERTICAL:
            heading = float(self._rng.uniform(-math.pi, math.pi))
        world = quat_multiply(quat_from_yaw(-heading), level)
        turned = quat_multiply(world, [0.0, 0.0, 0.0, 1.0])
        parts = (
            *(quat_rotate(world, axis) for axis in np.eye(3)),
            quat_multiply(world, self._mount_wxyz),
            quat_multiply(turned, self._mount_wxyz),
        )
        self._world = np.concatenate(parts)
        self._state = np.array([0.0, 0.0, 0.0, *in_wall, 0.0])
        self._started = True
