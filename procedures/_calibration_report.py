"""Tables and figures of an odometry calibration: the paper's Tables I to III, rounds, validation paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.calibration.evaluation import Track
from hil.kinematics import WheelGeometry
from hil.procedure import Context
from hil.report.run_plots import PALETTE, SERIES, legend, new_figure, style, thin


def parameter_table(ctx: Context, columns: Mapping[str, WheelGeometry]) -> None:
    """Table I: wheel parameters by method."""
    rows = []
    for label, key, scale in (
        ("x_w (mm)", "x_m", 1e3), ("y_w (mm)", "y_m", 1e3), ("r (mm)", "radius_m", 1e3),
        ("steering zero (deg)", "steering_zero_rad", float(np.degrees(1.0))),
    ):  # fmt: skip
        for wheel in range(4):
            values = [getattr(g, key)[wheel] * scale for g in columns.values()]
            rows.append([f"{label[:-1].replace(' (', f' {wheel + 1} (')})", *(f"{v:.3f}" for v in values)])
    ctx.table(
        "Table I: wheel parameters", ["parameter", *columns], rows,
        "Wheels 1 to 4 are FL, BL, BR, FR. Effective values: motions determine combinations, not each alone.",
    )  # fmt: skip


def error_table(ctx: Context, title: str, table: Any) -> None:
    """Table II or III: largest and mean-of-largest errors by motion."""
    keys = ("e_x_m", "e_x_a", "e_y_m", "e_y_a", "e_theta_m", "e_theta_a")
    rows = [
        [m.replace("_", " "), *(f"{row[k]:.4f}" for k in keys), f"{1e3 * row['rmse_position_m']:.2f}",
         f"{np.degrees(row['rmse_theta_rad']):.3f}"]
        for m, row in table["motions"].items()
    ]  # fmt: skip
    head = ["motion", "e_x,m", "e_x,a", "e_y,m", "e_y,a", "e_θ,m", "e_θ,a", "RMSE mm", "RMSE deg"]
    ctx.table(
        title, head, rows,
        "m and rad; m: largest of any repetition, a: mean over the repetitions of each one's largest.",
    )  # fmt: skip


def draw_rounds(ctx: Context, errors_m: Sequence[float]) -> None:
    """Position error of every round, driven and evaluated with the parameters of its time."""
    names = [f"round {k}" for k in range(1, len(errors_m))] + ["validation"]
    figure = new_figure(5.6, 3.0)
    axes = style(figure.add_subplot(), "", "position RMSE (mm)")
    values = 1e3 * np.array(errors_m)
    axes.bar(
        range(len(values)), values, color=[SERIES[1], *[SERIES[0]] * (len(values) - 2), SERIES[2]], width=0.6
    )
    axes.set_yscale("log")
    axes.set_xticks(range(len(values)), names, fontsize=8)
    for k, v in enumerate(values):
        axes.annotate(f"{v:.1f}", (k, v), ha="center", va="bottom", fontsize=8)
    axes.set_ylim(top=2 * values.max())
    ctx.figure(figure, "Rounds", "Each round is driven with the parameters found by the rounds before it.")


def draw_validation(ctx: Context, before: Sequence[Track], after: Sequence[Track]) -> None:
    """Paths and errors of the validation run, with the parameters before and after."""
    motions = list(dict.fromkeys(t.recording.motion for t in after))
    columns = 2
    rows = -(-len(motions) // columns)
    paths, errors = new_figure(6.4, 2.6 * rows), new_figure(6.4, 2.2 * rows)
    for k, motion in enumerate(motions, start=1):
        own = [(b, a) for b, a in zip(before, after, strict=True) if a.recording.motion == motion]
        _paths(paths.add_subplot(rows, columns, k), motion, *own[0], first=k == 1)
        axes = style(errors.add_subplot(rows, columns, k), "time (s)", "error (mm)", motion.replace("_", " "))
        for number, (b, a) in enumerate(own):
            for run, colour, name in ((b, SERIES[1], "before"), (a, SERIES[0], "after")):
                t_s, size = thin(run.t_s, 1e3 * np.hypot(run.error[:, 0], run.error[:, 1]))
                label = name if number == 0 and k == 1 else None
                axes.plot(t_s, size, color=colour, lw=1.1, label=label)
        axes.set_yscale("symlog", linthresh=1.0)
        legend(axes)
    ctx.figure(paths, "Validation: paths", "First repetition of each motion; turns are shown against time.")
    ctx.figure(errors, "Validation: position errors", "Every repetition; logarithmic above 1 mm.")


def _paths(axes: Any, motion: str, before: Track, after: Track, *, first: bool) -> None:
    turning = motion.startswith("rotation")
    style(
        axes,
        "time (s)" if turning else "x (m)",
        "heading (deg)" if turning else "y (m)",
        motion.replace("_", " "),
    )
    for pose, colour, width, name in (
        (after.truth, PALETTE["truth"], 2.0, "truth"), (before.odometry, SERIES[1], 1.1, "before"),
        (after.odometry, SERIES[0], 1.1, "after"),
    ):  # fmt: skip
        t_s, x, y, heading = thin(after.t_s, *pose.T)
        line = (t_s, np.degrees(heading)) if turning else (x, y)
        axes.plot(*line, color=colour, lw=width, label=name if first else None)
    if motion.startswith("circle"):
        axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
