"""Visual odometry of the emulated camera: true body poses in, measured camera poses out.

The pose is kept in a levelled world (x where the camera looked at the start, z against gravity) and returned
in the T265's axes, where that world is x right, y up, z back. On a wall, gravity lies in the motion plane, so
the drift about gravity tilts the path out of the wall.

One step works on flat vectors. The motion of the camera has named fields; other numbers are in three vectors
in SI units at the indices named below: error parameters, the levelled world, and the state.
"""

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
from hil.fakes.tracker.true_parameters import TrackerTruthOptions
from hil.support.numba_jit import compile_for, inner, kernel, plain

# Error parameters (7,), filled in this order by `VisualOdometry.__init__` from the truth options.
(YAW_RATE, YAW_WALK, POSITION_WALK, POSITION_NOISE, VELOCITY_NOISE, RATE_NOISE, ANGLE_NOISE) = range(7)

# The levelled world (17,): the wall's axes in it, and the parts of the camera's rotation (w, x, y, z) to be
# multiplied by cosine and sine of half the body's heading. `VisualOdometry._start` fills it and the state.
ALONG_X, ALONG_Y, ALONG_Z, COSINE_PART, SINE_PART = 0, 3, 6, 9, 13
WORLD_SIZE = 17

# State (6,): position in the levelled world, last seen position in the wall frame, heading error.
POSITION, LAST_X, LAST_Y, YAW = 0, 3, 4, 5
STATE_SIZE = 6

DRAWS = 16
"""Random numbers per pose."""

Pose = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]
_BLOCK = 512
_NEAR_VERTICAL = 0.2


class CameraMotion(NamedTuple):
    """Motion of the camera since the last pose, in the wall's axes.

    Attributes:
        theta, omega: true heading of the body, and its rate.
        x, y: position of the camera.
        along, left: velocity of the camera along wall x and y.
        speed: magnitude of that velocity.
        dt: time since the last pose.
        scale: factor on the measured motion.
        wheel_x, wheel_y: step by wheel odometry.
        weight: weight of the wheel odometry, 0 for none.
    """

    theta: float = 0.0
    omega: float = 0.0
    x: float = 0.0
    y: float = 0.0
    along: float = 0.0
    left: float = 0.0
    speed: float = 0.0
    dt: float = 0.0
    scale: float = 1.0
    wheel_x: float = 0.0
    wheel_y: float = 0.0
    weight: float = 0.0


@kernel
def step(way: CameraMotion, draws: Array, row: int, errors: Array, world: Array, state: Array) -> Pose:
    """Advance the odometry by one step and return the pose that it reports.

    The step is scaled, rotated by the heading error, and gets a random walk; wheel odometry corrects it.

    Args:
        way: motion of the camera since the last pose, as a `CameraMotion` or a plain tuple.
        draws: standard normal noise (n, 16).
        row: row of `draws` to use.
        errors: (7,) error parameters.
        world: (17,) levelled world.
        state: (6,) state; updated.

    Returns:
        position (3,), velocity (3,), rotation x y z w, angular velocity (3,) in the T265's axes.
    """
    way = CameraMotion(*way)
    noise, dt, scale = draws[row], way.dt, way.scale
    along, left, omega = way.along, way.left, way.omega
    root = math.sqrt(dt)
    state[YAW] += errors[YAW_RATE] * dt + errors[YAW_WALK] * root * noise[0]
    du, dv = scale * (way.x - state[LAST_X]), scale * (way.y - state[LAST_Y])
    state[LAST_X], state[LAST_Y] = way.x, way.y
    if way.weight != 0.0:
        du, dv = du + way.weight * (way.wheel_x - du), dv + way.weight * (way.wheel_y - dv)
    ax, ay, az = world[ALONG_X], world[ALONG_X + 1], world[ALONG_X + 2]
    bx, by, bz = world[ALONG_Y], world[ALONG_Y + 1], world[ALONG_Y + 2]
    dx, dy, dz = ax * du + bx * dv, ay * du + by * dv, az * du + bz * dv
    c, s = math.cos(state[YAW]), math.sin(state[YAW])
    walk = errors[POSITION_WALK] * math.sqrt(way.speed) * root
    px = state[POSITION] + c * dx - s * dy + walk * noise[1]
    py = state[POSITION + 1] + s * dx + c * dy + walk * noise[2]
    pz = state[POSITION + 2] + dz + walk * noise[3]
    state[POSITION], state[POSITION + 1], state[POSITION + 2] = px, py, pz
    sp, sv, sw = errors[POSITION_NOISE], errors[VELOCITY_NOISE], errors[RATE_NOISE]
    qx, qy, qz, qw = rotation(way.theta, state[YAW], noise, errors, world)
    return (  # each vector in the camera's axes: (-y, z, -x) of the robot's
        -(py + sp * noise[5]),
        pz + sp * noise[6],
        -(px + sp * noise[4]),
        -(ay * along + by * left + sv * noise[8]),
        az * along + bz * left + sv * noise[9],
        -(ax * along + bx * left + sv * noise[7]),
        -qy,
        qz,
        -qx,
        qw,
        -(world[ALONG_Z + 1] * omega + sw * noise[11]),
        world[ALONG_Z + 2] * omega + sw * noise[12],
        -(world[ALONG_Z] * omega + sw * noise[10]),
    )


@inner
def rotation(
    theta: float, yaw: float, noise: Array, errors: Array, world: Array
) -> tuple[float, float, float, float]:
    """Camera rotation in the levelled world (x, y, z, w); heading error and noise multiply from the left."""
    c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
    bw = c * world[COSINE_PART] + s * world[SINE_PART]
    bx = c * world[COSINE_PART + 1] + s * world[SINE_PART + 1]
    by = c * world[COSINE_PART + 2] + s * world[SINE_PART + 2]
    bz = c * world[COSINE_PART + 3] + s * world[SINE_PART + 3]
    half = 0.5 * errors[ANGLE_NOISE]
    ex, ey = half * noise[13], half * noise[14]
    turned = 0.5 * yaw + half * noise[15]
    ew, ez = math.cos(turned), math.sin(turned)
    w = ew * bw - ex * bx - ey * by - ez * bz
    x = ew * bx + ex * bw + ey * bz - ez * by
    y = ew * by - ex * bz + ey * bw + ez * bx
    z = ew * bz + ex * by - ey * bx + ez * bw
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return x / norm, y / norm, z / norm, w / norm


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
    """Convert a vector from robot axes (forward, left, up) to the camera's axes (right, up, back)."""
    return Vector(-y, z, -x)


class VisualOdometry:
    """Visual odometry of one camera on the body.

    Args:
        options: true imperfections.
        rng: random stream of the device.
        mount_position_m, mount_rotation_wxyz: true pose of the camera (robot axes) in the body.
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
        compile_for(step, plain(CameraMotion()), self._draws, 0, self._errors, self._world, self._state)
        self._started = False

    def restart(self) -> None:
        """Reset the map: the next pose is the origin of a new world."""
        self._started = False

    def jump(self, distance_m: float) -> None:
        """Shift the position at once, as after a relocalisation, in a random direction."""
        direction = self._rng.standard_normal(3)
        way = distance_m * direction / float(np.linalg.norm(direction))
        for k, by_m in enumerate(way.tolist()):
            self._state[POSITION + k] += by_m

    def drift(self, x_m: float, y_m: float) -> None:
        """Add a motion in the wall's axes, which the camera has not made, to the next step."""
        if self._started:
            self._state[LAST_X] -= x_m
            self._state[LAST_Y] -= y_m

    def rate_rad_s(self, omega_rad_s: float) -> Array:
        """Rate of turn in the camera's axes (3,)."""
        return self._in_camera([0.0, 0.0, omega_rad_s])

    def _in_camera(self, in_body: list[float]) -> Array:
        return np.array(camera_axes(*quat_rotate(quat_conjugate(self._mount_wxyz), in_body)))

    def _in_wall(self, in_camera: Array, theta_rad: float) -> tuple[float, float]:
        """Convert a vector from the camera's axes to its components along wall x and y."""
        right, up, back = in_camera
        x, y, _ = quat_rotate(self._mount_wxyz, [-back, -right, up])
        c, s = math.cos(theta_rad), math.sin(theta_rad)
        return c * x - s * y, s * x + c * y

    def observe(
        self, body: BodyMotion, dt_s: float, scale: float = 1.0, by_wheels: tuple[Array, float] | None = None
    ) -> CameraPose:
        """Return the measured pose for the body's true motion, `dt_s` after the last one.

        Args:
            body: true motion of the body.
            dt_s: time since the last pose.
            scale: factor on the measured motion.
            by_wheels: velocity by the wheels (3,), camera axes, m/s, and its weight relative to vision.
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
        way = CameraMotion(
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
        """Define the levelled world by gravity and the direction in which the camera looks."""
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
