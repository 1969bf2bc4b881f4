"""Report of the camera's mount: table, path, and error over latency."""

import numpy as np

from hil.config.device import TrackerConfig
from hil.procedure import Context
from hil.procedure.sample_arrays import Series
from hil.procedures.tracker_extrinsics.hand_eye import (
    Extrinsics,
    Intervals,
    Truth,
    camera_path,
    laid_over,
    lateness_curve,
)
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style, thin

_DEG = float(np.degrees(1.0))


def table(ctx: Context, found: Extrinsics) -> None:
    """Add a table of configured and found values, with 95 % intervals."""
    config = ctx.source.config.of(TrackerConfig)
    assert config is not None
    rows = [
        [
            axis,
            f"{1e3 * config.mount_position_m[k]:+.1f}",
            f"{1e3 * found.position_m[k]:+.2f}",
            f"± {1e3 * found.position_uncertainty_m[k]:.2f}",
            "mm",
        ]
        for k, axis in enumerate("xy")
    ]
    rows += [
        [
            name,
            "0",
            f"{found.angles_rad[k] * _DEG:+.3f}",
            f"± {found.angles_uncertainty_rad[k] * _DEG:.3f}",
            "deg",
        ]
        for k, name in enumerate(("roll", "pitch", "yaw"))
    ]
    rows.append(
        ["scale", f"{config.scale:.5f}", f"{found.scale:.5f}", f"± {found.scale_uncertainty:.5f}", "1"]
    )
    rows.append(
        [
            "latency",
            f"{1e3 * config.latency_s:.1f}",
            f"{1e3 * (config.latency_s + found.late_s):.2f}",
            f"± {1e3 * found.late_uncertainty_s:.2f}",
            "ms",
        ]
    )
    ctx.table(
        "Camera on the body",
        ["", "configured", "found", "95 %", "unit"],
        rows,
        "Angles are the turn of the mount against the configured one, about body axes. The height above the "
        "surface cannot be seen from motion along it.",
    )


def draw_path(ctx: Context, truth: Truth, seen: Series, found: Extrinsics) -> None:
    """Draw the camera's path from motion capture, and the camera's own path, aligned."""
    rows = truth.sees(seen.t_s - found.late_s)
    by_truth = camera_path(truth, seen.t_s[rows] - found.late_s, found)
    laid = laid_over(seen.values[rows, 0:3] / found.scale, by_truth)
    figure = new_figure(5.2, 3.4)
    axes = style(figure.add_subplot(), "y, left (m)", "x, forwards (m)")
    x, y = thin(*by_truth.T)
    axes.plot(y, x, color=PALETTE["truth"], lw=2.2, label="motion capture and mount found")
    x, y = thin(*laid.T)
    axes.plot(y, x, color=SERIES[0], lw=1.2, label="camera, aligned to it")
    axes.invert_xaxis()
    axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
    ctx.figure(figure, "Path of the camera", "The camera's own path as a whole turned and shifted to fit.")


def draw_lateness(ctx: Context, parts: Intervals, truth: Truth, found: Extrinsics) -> None:
    """Draw the error of the turn over latency, around the found value."""
    config = ctx.source.config.of(TrackerConfig)
    assert config is not None
    late = found.late_s + np.linspace(-0.03, 0.03, 61)
    curve = lateness_curve(parts, truth, found, config.mount_rotation_wxyz, late)
    figure = new_figure(5.2, 2.5)
    axes = style(figure.add_subplot(), "lateness of the camera's stamps (ms)", "error of the turn (mrad)")
    axes.plot(1e3 * late, 1e3 * curve, color=SERIES[0], lw=1.5)
    axes.axvline(1e3 * found.late_s, color=PALETTE["reference"], lw=1.2, ls="--", label="found")
    axes.axvline(0.0, color=PALETTE["truth"], lw=0.8, label="configured")
    axes.set_ylim(bottom=0.0)
    legend(axes)
    ctx.figure(
        figure, "Time offset", "RMS over all intervals; the valley is where camera and body turn together."
    )
