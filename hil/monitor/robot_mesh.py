"""The body that is drawn where the user gives no mesh: made from `[robot]`; pure numpy, no Rerun."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.config.robot import RobotConfig
from hil.core.geometry import Array
from hil.robot.kinematics import WheelGeometry

Colour = tuple[int, int, int]

LIGHT: Colour = (176, 186, 198)
DARK: Colour = (52, 60, 72)
NOSE: Colour = (0, 110, 230)
_HUB: Colour = (225, 225, 230)
_RUBBER: Colour = (40, 40, 44)

WHEEL_WIDTH_M = 0.022
PLATE_HEIGHT_M = 0.062
PLATE_THICKNESS_M = 0.008
_PLATE_SHARE = 0.62
_ARM_M, _THIN_M = 0.007, 0.003
_BLADES_M = 0.055
_SIDES = 24
_ROUND = np.linspace(0.0, 2.0 * math.pi, _SIDES + 1)


class Mesh(NamedTuple):
    """A coloured surface: vertices (n, 3) m, triangles of them (m, 3), a colour for each vertex."""

    vertices: Array
    triangles: npt.NDArray[np.int64]
    colours: list[Colour]


class Tube(NamedTuple):
    """A line through points (n, 3) in the body, as thick as a tube."""

    points: Array
    colour: Colour
    radius_m: float


def plate_size(geometry: WheelGeometry) -> tuple[float, float]:
    """Length and width of the plate, m: small enough that the wheels can be seen from above."""
    length_m, width_m = (2.0 * _PLATE_SHARE * float(np.max(np.abs(v))) for v in (geometry.x_m, geometry.y_m))
    return length_m, width_m


def outline(robot: RobotConfig) -> Array:
    """Closed outline with a nose towards body x, (8, 3), body frame, at the height of the plate."""
    x, y = (half / 2.0 for half in robot.outline_m)
    corners = [(x, y), (-x, y), (-x, -y), (x, -y), (x, -0.3 * y), (1.15 * x, 0.0), (x, 0.3 * y), (x, y)]
    return np.array([(*corner, PLATE_HEIGHT_M) for corner in corners])


def tubes(robot: RobotConfig, geometry: WheelGeometry) -> list[Tube]:
    """Arms from the plate to each wheel and down its steering axis, propellers, and a nose."""
    found = []
    for x, y, r in zip(geometry.x_m, geometry.y_m, geometry.radius_m, strict=True):
        arm = [(0.45 * x, 0.45 * y, PLATE_HEIGHT_M), (x, y, PLATE_HEIGHT_M), (x, y, 2.0 * r)]
        found.append(Tube(np.array(arm), DARK, _ARM_M))
    for side in (-1.0, 1.0):
        y, z = side * robot.propeller_y_m, robot.propeller_height_m
        stem = [(0.0, 0.3 * y, PLATE_HEIGHT_M), (0.0, y, PLATE_HEIGHT_M), (0.0, y, z)]
        circle = [(0.0, y + _BLADES_M * math.cos(a), z + _BLADES_M * math.sin(a)) for a in _ROUND]
        found += [Tube(np.array(stem), DARK, _THIN_M), Tube(np.array(circle), LIGHT, _THIN_M)]
    nose = [(0.5 * robot.outline_m[0] * share, 0.0, PLATE_HEIGHT_M) for share in (0.4, 0.95)]
    found.append(Tube(np.array(nose), NOSE, _THIN_M))
    return found


def wheel_mesh(radius_m: float) -> Mesh:
    """A wheel about its axle (y).

    Its sides have light and dark sectors, so that one sees it turn.

    Args:
        radius_m: radius of the wheel.
    """
    ring = radius_m * np.column_stack([np.cos(_ROUND), np.zeros(_SIDES + 1), np.sin(_ROUND)])
    half = np.array([0.0, 0.5 * WHEEL_WIDTH_M, 0.0])
    vertices: list[Array] = []
    colours: list[Colour] = []
    for k in range(_SIDES):
        a, b = ring[k], ring[k + 1]
        side = _HUB if k * 6 // _SIDES % 2 else _RUBBER
        for corners, colour in (
            ((a - half, b - half, a + half), _RUBBER),
            ((b - half, b + half, a + half), _RUBBER),
            ((half, 0.8 * a + half, 0.8 * b + half), side),
            ((-half, 0.8 * b - half, 0.8 * a - half), side),
            ((0.8 * a + half, a + half, b + half), _RUBBER),
            ((0.8 * a + half, b + half, 0.8 * b + half), _RUBBER),
            ((0.8 * a - half, b - half, a - half), _RUBBER),
            ((0.8 * a - half, 0.8 * b - half, b - half), _RUBBER),
        ):
            vertices += list(corners)
            colours += [colour] * 3
    triangles = np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
    return Mesh(np.array(vertices), triangles, colours)
