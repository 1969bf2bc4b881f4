"""A rigid body as the cameras see it.

Poses are made in the wall frame (z out of the surface) and turned into the streamed axes: Motive's
y-up stream has y out of the calibrated ground plane, so that (x, y, z) of the wall is (x, z, -y) there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.core.geometry import Array, Four, Three
from hil.support.numba_jit import inner, kernel

DRAWS = 7
"""Numbers of one row of noise."""

MARKERS = ((0.10, 0.08, 0.02), (-0.12, 0.09, 0.02), (-0.10, -0.09, 0.03), (0.13, -0.02, 0.05))
"""Where they sit on a body, m."""

Markers = tuple[Three, Three, Three, Three]


class Capture(NamedTuple):
    """How bodies are seen.

    Attributes:
        height: of a body above the surface, m.
        position_noise, angle_noise: standard deviation of each component, m and rad.
        marker_error: mean distance of the markers from where they should be, m.
        y_up: whether y is out of the ground plane.
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
        place: x and y of the body in the wall, m, and its heading.
        by: how it is seen.
        draws: noise, standard normal (n, 7).
        row: of the noise, that is this body's.
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
    """A vector in the wall's axes in those of the stream."""
    if y_up:
        return x, z, -y
    return x, y, z
