"""Figures of an IMU calibration: Allan deviation at rest, and heading from gravity against the truth."""

from collections.abc import Mapping

import numpy as np

from hil.core.geometry import Array
from hil.procedure import Context
from hil.procedures.imu_calibration.noise import Allan
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style

_DEG = float(np.degrees(1.0))


def draw_allan(ctx: Context, curves: Mapping[str, Allan], density: float) -> None:
    """Draw the Allan deviation over averaging time, per axis, and the fitted white noise."""
    figure = new_figure(5.2, 3.1)
    axes = style(figure.add_subplot(), "averaging time (s)", "Allan deviation (deg/s)")
    for colour, (axis, curve) in zip(SERIES, curves.items(), strict=False):
        axes.loglog(curve.tau_s, curve.deviation, color=colour, lw=1.5, label=f"chip {axis}")
        axes.fill_between(
            curve.tau_s,
            curve.deviation * (1 - curve.spread),
            curve.deviation * (1 + curve.spread),
            color=colour,
            alpha=0.15,
            lw=0,
        )
    tau = curves["x"].tau_s
    axes.loglog(
        tau,
        density / np.sqrt(tau),
        color=PALETTE["reference"],
        lw=1.0,
        ls="--",
        label=f"white noise {density:.4f} deg/s/√Hz",
    )
    axes.grid(which="minor", color=PALETTE["grid"], lw=0.3)
    legend(axes)
    ctx.figure(figure, "Turn rate at rest", "Bands: one standard deviation of the estimate.")


def draw_headings(ctx: Context, true: Array, error: Array, offset: float, slope: float) -> None:
    """Draw and tabulate the error of the gravity heading over heading; all arguments in rad."""
    figure = new_figure(5.2, 2.6)
    axes = style(
        figure.add_subplot(), "heading by motion capture (deg)", "gravity minus motion capture (deg)"
    )
    axes.plot(true * _DEG, error * _DEG, "o", color=SERIES[0], ms=5, label="one dwell each")
    fitted = (offset + slope * (true - true.mean())) * _DEG
    axes.plot(true * _DEG, fitted, color=PALETTE["reference"], lw=1.2, ls="--", label="fitted line")
    axes.axhline(0.0, color=PALETTE["truth"], lw=0.6)
    legend(axes)
    ctx.figure(
        figure,
        "Heading from gravity",
        "A constant part is a turned mount or an offset across; a slope is an offset along.",
    )
    rows = [
        [f"{t:+.2f}", f"{t + e:+.2f}", f"{e:+.3f}"] for t, e in zip(true * _DEG, error * _DEG, strict=True)
    ]
    ctx.table("Heading from gravity", ["motion capture (deg)", "gravity (deg)", "difference (deg)"], rows)
