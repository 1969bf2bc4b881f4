"""What the cameras see: the robot's rigid body, another one, and when they see them.

Poses are made in the wall frame (z out of the surface) and turned into the streamed axes: Motive's
y-up stream has y out of the calibrated ground plane, so that (x, y, z) of the wall is (x, z, -y) there.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from hil.fakes.mocap.options import MocapTruthOptions
from hil.fakes.plant_api import BodyMotion

_BLOCK = 512
_RARE_GAP = 0.02
_MARKERS = ((0.10, 0.08, 0.02), (-0.12, 0.09, 0.02), (-0.10, -0.09, 0.03), (0.13, -0.02, 0.05))
_DISTRACTOR = (1.2, -0.7, 0.4)

Point = tuple[float, float, float]


class SeenBody(NamedTuple):
    """One rigid body in streamed axes: m, quaternion x y z w, markers (4 points), m."""

    name: str
    identifier: int
    position_m: Point
    rotation_xyzw: tuple[float, float, float, float]
    markers_m: tuple[Point, ...]
    marker_error_m: float
    tracked: bool = True


class CaptureVolume:
    """The cameras, the robot's body and a second, resting body.

    Args:
        options: true imperfections.
        rng: random stream of the device.
        body, body_id: name and streaming id of the robot's body.
        up_axis: streaming setting.
    """

    def __init__(
        self,
        options: MocapTruthOptions,
        rng: np.random.Generator,
        *,
        body: str,
        body_id: int,
        up_axis: Literal["y", "z"],
    ) -> None:
        self._options, self._rng = options, rng
        self._body, self._body_id, self._y_up = body, body_id, up_axis == "y"
        x, y, theta = _DISTRACTOR
        name, identifier = "distractor" + "2" * (body == "distractor"), body_id + 1
        self._other = self._body_at(name, identifier, x, y, theta, (0.0,) * 7)
        self._last: SeenBody | None = None
        self._draws: list[list[float]] = []
        self._hidden_until_ns = self._gap_until_ns = 0

    @property
    def names(self) -> tuple[tuple[str, int], ...]:
        """Bodies that are defined, the other one first."""
        return (self._other.name, self._other.identifier), (self._body, self._body_id)

    def see(self, motion: BodyMotion, t_ns: int, *, hidden: bool = False) -> tuple[SeenBody, SeenBody]:
        """Both bodies at an exposure; a hidden body keeps its last pose and is not tracked."""
        x, y, theta = motion[:3]
        noise = self._noise()
        often = self._options.occlusions_per_s / self._options.rate_hz
        if often and t_ns >= self._hidden_until_ns and self._rng.random() < often:
            self._hidden_until_ns = t_ns + round(1e9 * self._options.occlusion_s)
        if (hidden or t_ns < self._hidden_until_ns) and self._last is not None:
            return self._other, self._last._replace(tracked=False)
        self._last = self._body_at(self._body, self._body_id, x, y, theta, tuple(noise))
        return self._other, self._last

    def in_gap(self, t_ns: int) -> bool:
        """Whether this frame is one of those that never leave the server."""
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

    def _noise(self) -> list[float]:
        if not self._draws:
            self._draws = self._rng.standard_normal((_BLOCK, 7)).tolist()
        return self._draws.pop()

    def _body_at(
        self, name: str, identifier: int, x: float, y: float, theta: float, noise: tuple[float, ...]
    ) -> SeenBody:
        options = self._options
        c, s = math.cos(theta), math.sin(theta)
        y_up, height_m = self._y_up, options.height_m
        places = [(x + c * mx - s * my, y + s * mx + c * my, height_m + mz) for mx, my, mz in _MARKERS]
        markers = tuple([(u, w, -v) for u, v, w in places] if y_up else places)
        sigma, half = options.position_noise_m, 0.5 * options.angle_noise_rad
        c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
        ex, ey, ez = half * noise[3], half * noise[4], half * noise[5]
        vector = self._streamed(c * ex - s * ey, c * ey + s * ex, s + c * ez)
        return SeenBody(
            name=name,
            identifier=identifier,
            position_m=self._streamed(
                x + sigma * noise[0], y + sigma * noise[1], options.height_m + sigma * noise[2]
            ),
            rotation_xyzw=(*vector, c - s * ez),
            markers_m=markers,
            marker_error_m=options.marker_error_m * (1.0 + 0.1 * abs(noise[6])),
        )

    def _streamed(self, x: float, y: float, z: float) -> Point:
        return (x, z, -y) if self._y_up else (x, y, z)
