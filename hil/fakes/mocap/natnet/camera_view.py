"""Rigid bodies in the view of the motion capture cameras: visibility and measured poses.

Poses are computed in the wall frame (z out of the surface) and converted to the streamed axes: in Motive's
y-up stream, y is out of the calibrated ground plane, so that (x, y, z) of the wall is (x, z, -y).
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from hil.core.geometry import Array, Four, Three, conjugated, multiplied, rotated
from hil.fakes.body_interface import BodyMotion
from hil.fakes.mocap.natnet.true_parameters import MocapTruthOptions
from hil.fakes.smooth_noise import SmoothNoise
from hil.support.numba_jit import compile_for, inner, kernel, plain

DRAWS = 7
"""Random numbers per body and frame."""

MARKERS = ((0.10, 0.08, 0.02), (-0.12, 0.09, 0.02), (-0.10, -0.09, 0.03), (0.13, -0.02, 0.05))
"""Positions of the markers on a body, m."""

Markers = tuple[Three, Three, Three, Three]
_BLOCK = 512
_RARE_GAP = 0.02
_STRAIGHT = (1.0, 0.0, 0.0, 0.0)
_MOVES_M_S, _MOVES_RAD_S = 0.002, 0.01
_DISTRACTOR = (1.2, -0.7, 0.4)


class Capture(NamedTuple):
    """Settings of the measurement of a body.

    Attributes:
        height: height of a body above the surface, m.
        position_noise, angle_noise: standard deviation of each component, m and rad.
        marker_error: mean marker error that is reported, m.
        y_up: True if y of the stream is out of the ground plane.
    """

    height: float = 0.0
    position_noise: float = 0.0
    angle_noise: float = 0.0
    marker_error: float = 0.0
    y_up: bool = False


@kernel
def seen_at(place: Three, by: Capture, draws: Array, row: int) -> tuple[Three, Four, Markers, float]:
    """Position (m), rotation (x, y, z, w), markers (m) and marker error (m) of a body, in streamed axes.

    Args:
        place: x and y of the body in the wall frame, m, and its heading, rad.
        by: settings.
        draws: standard normal noise (n, 7).
        row: row of `draws` to use.
    """
    by = Capture(*by)
    noise, height, y_up = draws[row], by.height, by.y_up
    x, y, theta = place
    c, s = math.cos(theta), math.sin(theta)
    a, b, m, n = MARKERS
    markers = (
        streamed(x + c * a[0] - s * a[1], y + s * a[0] + c * a[1], height + a[2], y_up),
        streamed(x + c * b[0] - s * b[1], y + s * b[0] + c * b[1], height + b[2], y_up),
        streamed(x + c * m[0] - s * m[1], y + s * m[0] + c * m[1], height + m[2], y_up),
        streamed(x + c * n[0] - s * n[1], y + s * n[0] + c * n[1], height + n[2], y_up),
    )
    c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
    half = 0.5 * by.angle_noise
    ex, ey, ez = half * noise[3], half * noise[4], half * noise[5]
    qx, qy, qz = streamed(c * ex - s * ey, c * ey + s * ex, s + c * ez, y_up)
    sigma = by.position_noise
    position = streamed(x + sigma * noise[0], y + sigma * noise[1], height + sigma * noise[2], y_up)
    return position, (qx, qy, qz, c - s * ez), markers, by.marker_error * (1.0 + 0.1 * abs(noise[6]))


@inner
def streamed(x: float, y: float, z: float, y_up: bool) -> Three:
    """Convert a vector from wall axes to streamed axes."""
    if y_up:
        return x, z, -y
    return x, y, z


class SeenBody(NamedTuple):
    """One rigid body in streamed axes: m, quaternion x y z w, markers (4 points), m."""

    name: str
    identifier: int
    position_m: Three
    rotation_xyzw: Four
    markers_m: tuple[Three, ...]
    marker_error_m: float
    tracked: bool = True


class CaptureVolume:
    """The cameras, the robot's body and a second body at rest.

    Args:
        options: true imperfections.
        rng: random stream of the device.
        own: random stream of the errors under way and of late stamps.
        body: name and streaming id of the robot's body.
        up_axis: streaming setting.
    """

    def __init__(
        self,
        options: MocapTruthOptions,
        rng: np.random.Generator,
        own: np.random.Generator,
        body: tuple[str, int],
        up_axis: Literal["y", "z"],
    ) -> None:
        self._options, self._rng, self._own = options, rng, own
        self._body, self._body_id = body
        self._under_way: SmoothNoise | None = None
        if options.exposure_jitter_s or options.moving_angle_noise_rad:
            self._under_way = SmoothNoise(own, 2, options.moving_noise_s, 1.0 / options.rate_hz)
        self._by = Capture(
            options.height_m,
            options.position_noise_m,
            options.angle_noise_rad,
            options.marker_error_m,
            up_axis == "y",
        )
        axes = options.plane_rotation_wxyz, options.body_rotation_wxyz
        self._axes: tuple[Four, Four] | None = None
        if any(turn != _STRAIGHT for turn in axes):
            (pw, px, py, pz), (bw, bx, by, bz) = axes
            y_up = up_axis == "y"
            self._axes = (pw, *streamed(px, py, pz, y_up)), (bw, *streamed(bx, by, bz, y_up))
        self._draws, self._row = np.zeros((1, DRAWS)), 0
        compile_for(seen_at, (0.0, 0.0, 0.0), plain(Capture()), self._draws, 0)
        name = "distractor" + "2" * (self._body == "distractor")
        self._other = self._body_at(name, self._body_id + 1, _DISTRACTOR, self._draws, 0)
        self._last: SeenBody | None = None
        self._hidden_until_ns = self._gap_until_ns = self._left_ns = 0

    @property
    def names(self) -> tuple[tuple[str, int], ...]:
        """Names and streaming ids of both bodies, that of the robot last."""
        return (self._other.name, self._other.identifier), (self._body, self._body_id)

    def see(self, motion: BodyMotion, t_ns: int, hidden: bool = False) -> tuple[SeenBody, SeenBody]:
        """Return both bodies at an exposure; a hidden body keeps its last pose and is not tracked."""
        if not self._row:
            self._draws, self._row = self._rng.standard_normal((_BLOCK, DRAWS)), _BLOCK
        self._row -= 1
        often = self._options.occlusions_per_s / self._options.rate_hz
        if often and t_ns >= self._hidden_until_ns and self._rng.random() < often:
            self._hidden_until_ns = t_ns + round(1e9 * self._options.occlusion_s)
        if (hidden or t_ns < self._hidden_until_ns) and self._last is not None:
            return self._other, self._last._replace(tracked=False)
        place = motion[:3] if self._under_way is None else self._place(motion, self._under_way)
        self._last = self._body_at(self._body, self._body_id, place, self._draws, self._row)
        return self._other, self._last

    def _place(self, motion: BodyMotion, noise: SmoothNoise) -> Three:
        """Pose at the true time of the exposure, with the noise of a body under way."""
        options = self._options
        early, turned = noise.step().tolist()
        late_s, v, w = options.exposure_jitter_s * early, motion.v_x_m_s, motion.v_y_m_s
        moves = math.hypot(v, w) > _MOVES_M_S or abs(motion.omega_rad_s) > _MOVES_RAD_S
        theta = motion.theta_rad + late_s * motion.omega_rad_s
        c, s = math.cos(motion.theta_rad), math.sin(motion.theta_rad)
        x, y = motion.x_m + late_s * (c * v - s * w), motion.y_m + late_s * (s * v + c * w)
        return x, y, theta + options.moving_angle_noise_rad * turned * moves

    def late_ns(self, t_ns: int) -> int:
        """Draw the time at which a frame exposed at `t_ns` is stamped and sent; never before the last one."""
        mean_s = self._options.stamp_late_s
        if mean_s:
            drawn_ns = t_ns + round(1e9 * mean_s * float(self._own.standard_exponential()))
            self._left_ns = max(self._left_ns + 1, drawn_ns)
            return self._left_ns
        return t_ns

    def in_gap(self, t_ns: int) -> bool:
        """Return whether this frame is lost before it is sent."""
        options = self._options
        if t_ns < self._gap_until_ns:
            return True
        if self._rng.random() >= options.gaps_per_s / options.rate_hz:
            return False
        kind, length = self._rng.random(2).tolist()
        if kind >= options.single_gap_share:
            longest_s = options.longest_gap_s if kind > 1.0 - _RARE_GAP else options.common_gap_s
            self._gap_until_ns = t_ns + round(1e9 * max(0.0, longest_s * length - 1.0 / options.rate_hz))
        return True

    def _body_at(self, name: str, identifier: int, place: Three, draws: Array, row: int) -> SeenBody:
        """Return a body at a pose in the wall frame, with a row of noise."""
        seen = SeenBody(name, identifier, *seen_at(place, plain(self._by), draws, row), True)
        return seen if self._axes is None else in_axes(seen, *self._axes)


def in_axes(body: SeenBody, plane_wxyz: Four, body_wxyz: Four) -> SeenBody:
    """A body in the axes of another plane, and with other axes of its own.

    Args:
        body: the body in streamed axes.
        plane_wxyz: axes of the plane.
        body_wxyz: axes of the rigid body in the body.
    """
    back = conjugated(plane_wxyz)
    x, y, z, w = body.rotation_xyzw
    w, x, y, z = multiplied(multiplied(back, (w, x, y, z)), body_wxyz)
    return body._replace(
        position_m=rotated(back, body.position_m),
        rotation_xyzw=(x, y, z, w),
        markers_m=tuple(rotated(back, marker) for marker in body.markers_m),
    )
