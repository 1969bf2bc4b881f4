"""Report of a bring-up: sample streams, clocks, direction of each wheel, exchanged wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.config.encoders import EncodersConfig
from hil.config.servos import ServosConfig
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.loop.checks.wrong_parameter import explained
from hil.procedure import Context
from hil.procedures.bring_up.jogs import DriveJogs, SteerJogs, exchanged_axes, exchanged_drives
from hil.procedures.bring_up.streams import Stream
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_EXPLAINED = 0.25
"""Difference of a response from 1 that needs an explanation: more than slip, or a scale of a new camera."""


def stream_table(ctx: Context, streams: Mapping[str, Stream]) -> None:
    """Add a table of rates, gaps and ages."""
    rows = [
        [
            name,
            f"{s.rate_hz:.1f}",
            f"{100 * s.delivered:.1f}",
            *(f"{1e3 * v:.2f}" for v in (*s.gap_s, *s.age_s)),
        ]
        for name, s in streams.items()
    ]
    head = [
        "device",
        "rate (Hz)",
        "usable (%)",
        "gap median",
        "gap 99 %",
        "gap largest",
        "age median",
        "age 99 %",
    ]
    ctx.table("Sample streams at rest", head, rows, "ms; age is the time from measurement to arrival.")


def note_exchanged(ctx: Context, straight: DriveJogs, across: DriveJogs, steer: SteerJogs) -> set[str]:
    """Note which servos are probably exchanged, and how to correct it; return the names of their joints."""
    config, named = ctx.source.config, set[str]()
    servos, encoders = config.of(ServosConfig), config.of(EncodersConfig)
    assert servos is not None
    if drives := exchanged_drives(straight, across):
        named |= {WHEELS[k] for k in drives}
        joints = ", ".join(f"drive_{WHEELS[k]}" for k in drives)
        ids = _put(servos.drive_ids, {other: k for k, other in drives.items()})
        ctx.note(
            f"{joints} push where another one should: servos.drive_ids = {ids} fits; then run this again."
        )
    if axes := exchanged_axes(steer):
        named |= {WHEELS[k] for k in axes}
        joints = ", ".join(f"steer_{WHEELS[k]}" for k in axes)
        signals = _put(() if encoders is None else encoders.signals, {other: k for k, other in axes.items()})
        ctx.note(
            f"{joints} turn, by the encoders, where another one should: servos.steer_ids = "
            f"{_put(servos.steer_ids, axes)} fits; or, if the wheels turn as commanded, encoders.signals = "
            f"{signals}; then run this again."
        )
    return named


def _put(values: Sequence[Any], places: Mapping[int, int]) -> list[Any]:
    """Return a list in another order: the places from which its values come."""
    return [values[places.get(k, k)] for k in range(len(values))]


def note_other_values(ctx: Context, found: Mapping[str, Mapping[str, Any]]) -> None:
    """Note each key of the bench file that the small motions contradict, and the value that fits."""
    for table, values in found.items():
        for key, value in values.items():
            said = list(getattr(getattr(ctx.source.config, table), key))
            if list(value) != said:
                ctx.note(f"{table}.{key}: {value} fits, the bench file says {said}.")


def note_explanation(ctx: Context, source: str, response: float, axis: int) -> None:
    """Note the key of the bench file that would explain a sensor's response to a step of the body.

    Args:
        ctx: context of the run.
        source: kind of the sensor.
        response: motion seen over motion of the body.
        axis: 0 forwards, 1 to the left, 2 a turn.
    """
    if abs(response - 1.0) > _EXPLAINED and (found := explained(source, complex(response), turns=axis == 2)):
        ctx.note(f"{source}: {response:.2f} of the body's motion: look at {found.key}, {found.text}.")


def draw_streams(ctx: Context, streams: Mapping[str, Stream]) -> None:
    """Draw the gaps of every stream: median to 99th percentile as a bar, the largest as a mark."""
    names = list(streams)
    figure = new_figure(5.2, 0.66 + 0.42 * len(names))
    axes = style(figure.add_subplot(), "time between samples (ms)", "")
    for row, stream in enumerate(streams.values()):
        middle, late, largest = (1e3 * v for v in stream.gap_s)
        axes.plot(
            [middle, late],
            [row, row],
            color=SERIES[0],
            lw=6,
            solid_capstyle="butt",
            label="median to 99 %" if row == 0 else None,
        )
        axes.plot([middle], [row], "|", color=PALETTE["truth"], ms=12, mew=2)
        axes.plot([largest], [row], "D", color=SERIES[1], ms=5, label="largest" if row == 0 else None)
    axes.set_xscale("log")
    axes.set_xticks([5, 10, 20, 50, 100, 200, 500], minor=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    legend(axes, columns=2)
    ctx.figure(figure, "Time between samples", "The upright mark is the median.")


def draw_clocks(ctx: Context, streams: Mapping[str, Stream]) -> None:
    """Draw the drift of the devices' clocks against the bench clock."""
    figure = new_figure(5.2, 2.5)
    axes = style(figure.add_subplot(), "time (s)", "delay against own clock (ms)")
    for colour, (name, stream) in zip(SERIES, streams.items(), strict=False):
        if stream.lag.shape[1]:
            label = f"{name} {stream.drift_ppm:+.1f} ± {stream.drift_uncertainty_ppm:.1f} ppm"
            axes.plot(stream.lag[0], 1e3 * stream.lag[1], "o-", ms=3, lw=1.0, color=colour, label=label)
    legend(axes)
    ctx.figure(
        figure,
        "Clocks",
        "Smallest delay in each stretch of time. A falling line means that the device clock is fast.",
    )


def draw_directions(ctx: Context, rounds: Sequence[DriveJogs]) -> None:
    """Draw a plan of the robot with the measured and the expected push of each wheel."""
    robot = ctx.source.config.robot
    figure = new_figure(5.2, 3.0)
    for column, jogs in enumerate(rounds, start=1):
        title = f"steering {np.degrees(jogs.steering_rad):.0f}°"
        axes = style(figure.add_subplot(1, len(rounds), column), "to the right (m)", "forwards (m)", title)
        length, width = robot.outline_m
        axes.plot(
            np.array([1, 1, -1, -1, 1]) * width / 2,
            np.array([1, -1, -1, 1, 1]) * length / 2,
            color=PALETTE["reference"],
            lw=0.8,
        )
        for k, wheel in enumerate(WHEELS):
            x, y = robot.wheel_x_m[k], robot.wheel_y_m[k]
            _arrow(axes, x, y, jogs.expected[k], PALETTE["reference"], 3.5)
            right = jogs.agreement()[k] >= 0.5
            _arrow(axes, x, y, jogs.found[k], SERIES[0] if right else PALETTE["c5"], 1.5)
            axes.annotate(
                f"{wheel}\n{jogs.agreement()[k]:+.2f}",
                (-np.sign(y) * 0.24, x),
                fontsize=8,
                ha="center",
                va="center",
            )
        axes.set_xlim(-0.3, 0.3)
        axes.set_ylim(-0.3, 0.3)
        axes.set_aspect("equal")
    ctx.figure(
        figure,
        "Directions of the drives",
        "Grey: the direction in which this wheel should push the body when it rolls forwards. Colour: the "
        "direction measured (red: wrong), with the cosine between both. Seen from outside, front up.",
    )


def _arrow(axes: Axes, x: float, y: float, push: Array, colour: str, width: float) -> None:
    """Draw the displacement of a wheel's place under a body displacement (unit vector), 80 mm long."""
    reach = np.hypot(x, y)
    turn = push[2] / reach
    step = np.array([push[0] - turn * y, push[1] + turn * x])
    step *= 0.08 / max(float(np.linalg.norm(step)), 1e-9)
    axes.annotate(
        "",
        (-(y + step[1]), x + step[0]),
        (-y, x),
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )
