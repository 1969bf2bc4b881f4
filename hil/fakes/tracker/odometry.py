"""Visual odometry of the emulated camera: true body poses in, erring camera poses out.

The pose is kept in a levelled world (x where the camera looked at the start, z against gravity) and
given out in the T265's axes, where that world is x right, y up, z back. On a wall gravity lies in the
motion plane, so the drift about gravity tilts the path out of the wall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.fakes.plant_api import BodyMotion
from hil.fakes.tracker.options import TrackerTruthOptions
from hil.vocabulary.geometry import (
    Array,
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
)

_BLOCK = 512
_DRAWS = 16
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
        self.scale = 1.0 + options.scale_sigma * float(rng.standard_normal())
        if options.session_scale_sigma > 0.0:
            session = np.random.default_rng((options.session, int(self.scale * 1e12)))
            self.scale += options.session_scale_sigma * float(session.standard_normal())
        self._yaw_rate_rad_s = options.yaw_rate_sigma_rad_s * float(rng.standard_normal())
        self._draws: list[list[float]] = []
        self._started = False
        self._position = [0.0, 0.0, 0.0]
        self._last = (0.0, 0.0)
        self._yaw_rad = 0.0

    def restart(self) -> None:
        """Lose the map: the next pose is the origin of a new world."""
        self._started = False

    def jump(self, distance_m: float) -> None:
        """Correct the position at once, as a relocalisation does: translation only."""
        direction = self._rng.standard_normal(3)
        step = distance_m * direction / float(np.linalg.norm(direction))
        self._position = [p + s for p, s in zip(self._position, step.tolist(), strict=True)]

    def drift(self, x_m: float, y_m: float) -> None:
        """See a way in the wall's axes that the camera has not gone, together with the next step."""
        if self._started:
            self._last = self._last[0] - x_m, self._last[1] - y_m

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
        arm = c * mx - s * my, s * mx + c * my
        in_wall = x + arm[0], y + arm[1]
        speed = c * vx - s * vy - omega * arm[1], s * vx + c * vy + omega * arm[0]
        if not self._started:
            self._start(theta, tilt, in_wall)
        noise = self._noise()
        told = None
        if by_wheels is not None:
            velocity, weight = by_wheels
            u, v = self._in_wall(velocity, theta)
            told = u * dt_s, v * dt_s, weight
        self._move(in_wall, math.hypot(*speed), dt_s, scale, noise, told)
        return self._pose(theta, speed, omega, noise)

    def _noise(self) -> list[float]:
        if not self._draws:
            self._draws = self._rng.standard_normal((_BLOCK, _DRAWS)).tolist()
        return self._draws.pop()

    def _start(self, theta_rad: float, tilt_rad: float, in_wall: tuple[float, float]) -> None:
        """Fix the levelled world by gravity and the direction the camera looks."""
        level = quat_from_rotvec([0.0, -tilt_rad, 0.0])
        body = quat_multiply(level, quat_from_yaw(theta_rad))
        forward = quat_rotate(quat_multiply(body, self._mount_wxyz), [1.0, 0.0, 0.0])
        heading = math.atan2(forward[1], forward[0])
        if math.hypot(forward[0], forward[1]) < _NEAR_VERTICAL:
            heading = float(self._rng.uniform(-math.pi, math.pi))
        world = quat_multiply(quat_from_yaw(-heading), level)
        self._along_x, self._along_y, self._along_z = (
            tuple(quat_rotate(world, axis).tolist()) for axis in np.eye(3)
        )
        turned = quat_multiply(world, [0.0, 0.0, 0.0, 1.0])
        self._cosine_part = quat_multiply(world, self._mount_wxyz).tolist()
        self._sine_part = quat_multiply(turned, self._mount_wxyz).tolist()
        self._last, self._position, self._yaw_rad = in_wall, [0.0, 0.0, 0.0], 0.0
        self._started = True

    def _move(
        self, in_wall: tuple[float, float], speed_m_s: float, dt_s: float, scale: float, noise: list[float],
        told: tuple[float, float, float] | None,
    ) -> None:  # fmt: skip
        """Integrate the step as the odometry sees it: scaled, turned by its heading error, walking.

        What the wheels have told (step along wall x and y, weight) pulls the step towards itself.
        """
        options, root = self._options, math.sqrt(dt_s)
        self._yaw_rad += self._yaw_rate_rad_s * dt_s + options.yaw_walk_rad_sqrt_s * root * noise[0]
        scale *= self.scale
        du, dv = scale * (in_wall[0] - self._last[0]), scale * (in_wall[1] - self._last[1])
        self._last = in_wall
        if told is not None:
            du, dv = du + told[2] * (told[0] - du), dv + told[2] * (told[1] - dv)
        ax, ay = self._along_x, self._along_y
        dx, dy, dz = ax[0] * du + ay[0] * dv, ax[1] * du + ay[1] * dv, ax[2] * du + ay[2] * dv
        c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        walk = options.position_walk_m_sqrt_m * math.sqrt(speed_m_s) * root
        x, y, z = self._position
        self._position = [
            x + c * dx - s * dy + walk * noise[1],
            y + s * dx + c * dy + walk * noise[2],
            z + dz + walk * noise[3],
        ]

    def _pose(
        self, theta_rad: float, speed: tuple[float, float], omega_rad_s: float, noise: list[float]
    ) -> CameraPose:
        options = self._options
        sp, sv, sw = options.position_noise_m, options.velocity_noise_m_s, options.rate_noise_rad_s
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = self._along_x, self._along_y, self._along_z
        x, y, z = self._position
        along, left = speed
        _, _, _, _, px, py, pz, vx, vy, vz, wx, wy, wz, *_ = noise
        qx, qy, qz, qw = self._rotation(theta_rad, noise)
        return CameraPose(  # each vector in the camera's axes: (-y, z, -x) of the robot's
            Vector(-(y + sp * py), z + sp * pz, -(x + sp * px)),
            Vector(
                -(ay * along + by * left + sv * vy),
                az * along + bz * left + sv * vz,
                -(ax * along + bx * left + sv * vx),
            ),
            Quaternion(-qy, qz, -qx, qw),
            Vector(-(cy * omega_rad_s + sw * wy), cz * omega_rad_s + sw * wz, -(cx * omega_rad_s + sw * wx)),
        )

    def _rotation(self, theta_rad: float, noise: list[float]) -> tuple[float, float, float, float]:
        """Camera in the levelled world (x, y, z, w): heading error and noise on the left."""
        c, s = math.cos(0.5 * theta_rad), math.sin(0.5 * theta_rad)
        (cw, cx, cy, cz), (sw, sx, sy, sz) = self._cosine_part, self._sine_part
        bw, bx, by, bz = c * cw + s * sw, c * cx + s * sx, c * cy + s * sy, c * cz + s * sz
        half = 0.5 * self._options.angle_noise_rad
        ex, ey = half * noise[13], half * noise[14]
        yaw = 0.5 * self._yaw_rad + half * noise[15]
        ew, ez = math.cos(yaw), math.sin(yaw)
        w = ew * bw - ex * bx - ey * by - ez * bz
        x = ew * bx + ex * bw + ey * bz - ez * by
        y = ew * by - ex * bz + ey * bw + ez * bx
        z = ew * bz + ex * by - ey * bx + ez * bw
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        return x / norm, y / norm, z / norm, w / norm
