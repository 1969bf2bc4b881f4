"""Draws the robot on its wall from the geometry of a bench file: outline, wheels, sensors, axes, gravity.

python docs/images/render_robot_on_wall.py [--bench my.toml] [--out docs/images/robot_on_wall.svg]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon

from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.geometry import Array
from hil.core.signals import WHEELS

HERE = Path(__file__).resolve().parent
_INK, _BODY, _WALL, _X, _Y, _SENSOR = "#1c2733", "#dfe7ef", "#f4f1ea", "#c0392b", "#1e8449", "#1f5fa8"
_HEADING_RAD, _STEER_RAD = math.radians(10.0), math.radians(20.0)
_WHEEL_WIDTH_M = 0.022


def placed(points: Array, heading_rad: float, at: Array) -> Array:
    """Body points (n, 2) as points of the picture: wall X is up, wall Y is to the left."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    wall = points @ np.array([[c, s], [-s, c]]) + at
    return np.column_stack((-wall[:, 1], wall[:, 0]))


def box(centre: Array, length_m: float, width_m: float, angle_rad: float = 0.0) -> Array:
    """Corners (4, 2) of a rectangle in the body, x along its length."""
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * np.array([length_m, width_m]) / 2.0
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(half @ np.array([[c, s], [-s, c]]) + centre, dtype=np.float64)


def arrow(axes: Axes, start: Array, end: Array, colour: str, width: float = 1.8) -> None:
    """An arrow between two points of the picture."""
    axes.annotate(
        "",
        xy=tuple(end),
        xytext=tuple(start),
        zorder=6,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )


def label(
    axes: Axes, text: str, at: tuple[float, float], to: Array | None = None, colour: str = _INK
) -> None:
    """A label, with a thin line to what it names."""
    if to is None:
        axes.text(*at, text, color=colour, fontsize=9, ha="center", va="center", zorder=7)
        return
    axes.annotate(
        text,
        xy=tuple(to),
        xytext=at,
        color=colour,
        fontsize=9,
        va="center",
        zorder=7,
        ha="left" if at[0] > to[0] else "right",
        arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.7, "shrinkA": 2, "shrinkB": 0},
    )


def draw_robot(axes: Axes, config: BenchConfig) -> None:
    """The robot at the picture's origin, turned a little so that body and wall axes differ."""
    robot, at = config.robot, np.zeros(2)

    def body(*points: tuple[float, float]) -> Array:
        return placed(np.array(points), _HEADING_RAD, at)

    length_m, width_m = robot.outline_m
    outline = placed(box(at, length_m, width_m), _HEADING_RAD, at)
    axes.add_patch(Polygon(outline, fc=_BODY, ec=_INK, lw=1.4, joinstyle="round", zorder=2))
    (fan,) = body((0.0, 0.0))
    axes.add_patch(Circle(tuple(fan), 0.045, fc="white", ec=_INK, lw=1.0, zorder=3))
    for spoke in np.linspace(0.0, math.pi, 4)[:-1]:
        reach = 0.045 * np.array([math.cos(spoke), math.sin(spoke)])
        axes.plot(*zip(fan - reach, fan + reach, strict=True), color="#9aa7b4", lw=0.8, zorder=3)
    for side in (-1, 1):
        (propeller,) = body((0.0, side * robot.propeller_y_m))
        axes.add_patch(Circle(tuple(propeller), 0.035, fc="none", ec="#7d8a97", lw=1.0, ls="--", zorder=3))
        arrow(axes, propeller, body((0.09, side * robot.propeller_y_m))[0], "#7d8a97", 1.2)
    for x, y, r, name in zip(robot.wheel_x_m, robot.wheel_y_m, robot.wheel_radius_m, WHEELS, strict=True):
        wheel = placed(box(np.array([x, y]), 2 * r, _WHEEL_WIDTH_M, _STEER_RAD), _HEADING_RAD, at)
        axes.add_patch(Polygon(wheel, fc=_INK, ec=_INK, lw=1.0, zorder=4))
        side = 1 if y > 0 else -1
        label(axes, name, tuple(body((x + 0.045 * (1 if x > 0 else -1), y - 0.028 * side))[0]))
    arrow(axes, fan, body((0.12, 0.0))[0], _X)
    arrow(axes, fan, body((0.0, 0.10))[0], _Y)
    label(axes, "x", tuple(body((0.135, 0.0))[0]), colour=_X)
    label(axes, "y", tuple(body((0.0, 0.115))[0]), colour=_Y)
    label_parts(axes, config, body)


def label_parts(axes: Axes, config: BenchConfig, body: Callable[..., Array]) -> None:
    """Sensors at their mounts and what drives the robot, each with its name."""
    assert config.tracker is not None
    assert config.imu is not None
    robot = config.robot
    for mount_m, text, at in (
        (config.tracker.mount_position_m, "T265 tracking camera", (0.24, 0.29)),
        (config.imu.mount_position_m, "BNO055 IMU", (-0.25, 0.085)),
    ):
        (point,) = body((mount_m[0], mount_m[1]))
        axes.add_patch(Circle(tuple(point), 0.010, fc=_SENSOR, ec="white", lw=0.8, zorder=6))
        label(axes, text, at, point, _SENSOR)
    x, y = robot.wheel_x_m[2], robot.wheel_y_m[2]
    label(
        axes,
        "each wheel: a driving and\na steering XH430, an AS5045\non the steering axis",
        (0.24, -0.17),
        body((x, y))[0],
    )
    label(
        axes, f"ducted fan: {robot.edf_force_n:g} N\ntowards the wall", (-0.25, -0.11), body((-0.02, 0.03))[0]
    )
    share = f"{100 * robot.thrust_compensation:g} % of the weight"
    label(axes, f"two propellers:\n{share}", (0.26, 0.12), body((0.0, 0.035 - robot.propeller_y_m))[0] + 0.02)
    (centre,) = body((robot.centre_of_mass_m[0], robot.centre_of_mass_m[1]))
    axes.plot(*centre, marker="P", ms=7, color=_INK, mec="white", mew=0.6, zorder=6)
    label(axes, "centre of mass", (0.26, -0.02), centre)
    arrow(axes, centre, centre - np.array([0.0, 0.17]), _INK, 2.2)
    label(axes, f"gravity, {robot.mass_kg:g} kg", (0.01, -0.235), None)


def draw(config: BenchConfig) -> Figure:
    """The picture."""
    figure = Figure(figsize=(8.6, 6.1))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.5, 0.5), ylim=(-0.355, 0.354), aspect="equal")
    axes.axis("off")
    axes.add_patch(
        FancyBboxPatch(
            (-0.485, -0.34), 0.97, 0.68, boxstyle="round,pad=0.005", fc=_WALL, ec="#c9c2b2", lw=1.2
        )
    )
    origin = np.array([-0.34, -0.30])
    arrow(axes, origin, origin + np.array([0.0, 0.16]), _X, 2.4)
    arrow(axes, origin, origin - np.array([0.08, 0.0]), _Y, 2.4)
    label(axes, "X up the wall", (origin[0] + 0.075, origin[1] + 0.15), colour=_X)
    label(axes, "Y left", (origin[0] - 0.05, origin[1] + 0.022), colour=_Y)
    label(axes, "the wall, seen from the room", (0.34, 0.315), colour="#8a8270")
    label(axes, "OptiTrack watches from the room: ground truth", (0.25, -0.315), colour=_SENSOR)
    draw_robot(axes, config)
    return figure


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bench", default="emulated")
    parser.add_argument("--out", type=Path, default=HERE / "robot_on_wall.svg")
    given = parser.parse_args()
    mpl.rcParams["svg.hashsalt"] = "robot"
    draw(load_bench(given.bench)).savefig(
        given.out, metadata={"Date": None} if given.out.suffix == ".svg" else None
    )
    print(given.out)


if __name__ == "__main__":
    main()
