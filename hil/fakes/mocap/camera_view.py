"""Rigid bodies in the view of the cameras, and when these see them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from hil.core.geometry import Array, Four, Three
from hil.fakes.body_interface import BodyMotion
from hil.fakes.mocap.capture_truth import MocapTruthOptions
from hil.fakes.mocap.rigid_body_view import DRAWS, Capture, seen_at
from hil.support.numba_jit import compile_for, plain

_BLOCK = 512
_RARE_GAP = 0.02
_DISTRACTOR = (1.2, -0.7, 0.4)


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
        self._body, self._body_id = body, body_id
        self._by = Capture(
            options.height_m,
            options.position_noise_m,
            options.angle_noise_rad,
            options.marker_error_m,
            up_axis == "y",
        )
        self._draws, self._row = np.zeros((1, DRAWS)), 0
        compile_for(seen_at, (0.0, 0.0, 0.0), plain(Capture()), self._draws, 0)
        name = "distractor" + "2" * (body == "distractor")
        self._other = self._body_at(name, body_id + 1, _DISTRACTOR, self._draws, 0)
        self._last: SeenBody | None = None
        self._hidden_until_ns = self._gap_until_ns = 0

    @property
    def names(self) -> tuple[tuple[str, int], ...]:
        """Bodies that are defined, the other one first."""
        return (self._other.name, self._other.identifier), (self._body, self._body_id)

    def see(self, motion: BodyMotion, t_ns: int, hidden: bool = False) -> tuple[SeenBody, SeenBody]:
        """Both bodies at an exposure; a hidden body keeps its last pose and is not tracked."""
        if not self._row:
            self._draws, self._row = self._rng.standard_normal((_BLOCK, DRAWS)), _BLOCK
        self._row -= 1
        often = self._options.occlusions_per_s / self._options.rate_hz
        if often and t_ns >= self._hidden_until_ns and self._rng.random() < often:
            self._hidden_until_ns = t_ns + round(1e9 * self._options.occlusion_s)
        if (hidden or t_ns < self._hidden_until_ns) and self._last is not None:
            return self._other, self._last._replace(tracked=False)
        self._last = self._body_at(self._body, self._body_id, motion[:3], self._draws, self._row)
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

    def _body_at(self, name: str, identifier: int, place: Three, draws: Array, row: int) -> SeenBody:
        """A body at a pose in the wall, with a row of noise."""
        seen = seen_at(place, plain(self._by), draws, row)
        return SeenBody(name, identifier, *seen, True)
