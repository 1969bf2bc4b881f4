"""Tables and figures of an odometry calibration: the paper's Tables I to III, rounds, validation paths."""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from hil.calibration.calibrate import Calibration
from hil.calibration.evaluation import Track, evaluate
from hil.calibration.fitting import fit
from hil.procedure import Context
from hil.procedures.odometry_calibration.rounds import Driven, Odometry
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, plain_log, style, thin

_NAMED = 4
"""Number of recordings that a note names; the others are counted."""


def show(
    ctx: Context,
    rounds: Sequence[Driven],
    fresh: Driven,
    result: Calibration,
    method: str,
    compared_methods: Sequence[str],
) -> None:
    """Leave all tables, figures and notes about the result."""
    model = result.setting.model
    columns = {"nominal": Odometry(result.nominal, model), method: Odometry(result.geometry, model)}
    for other in compared_methods:
        reported = partial(ctx.progress, f"{other} generations")
        blocks = result.fit.problem.blocks
        found = fit(blocks, result.setting, result.nominal, method=other, seed=ctx.seed, progress=reported)
        columns[other] = Odometry(found.geometry, model)
    parameter_table(ctx, columns, result)
    before, after = rounds[0].tracks(), fresh.tracks()
    error_table(ctx, "Table II: errors before calibration", evaluate(before))
    error_table(ctx, "Table III: errors after calibration", evaluate(after))
    method_table(ctx, columns, fresh)
    round_table(ctx, [*rounds, fresh])
    observable_table(ctx, result)
    draw_rounds(ctx, [*rounds, fresh])
    draw_validation(ctx, rounds[0].odometry.tracks(fresh.recordings), after)
    names = {recording.name for run in (*rounds, fresh) for recording in run.recordings}
    for line in joined(result.warnings, names):
        ctx.note(f"{line}.")


def joined(warnings: Sequence[str], names: Collection[str]) -> list[str]:
    """Return warnings of a calibration without a full stop; merge equal ones about several recordings.

    Args:
        warnings: warnings, each about one recording, `NAME: text`, or about the calibration.
        names: names of the recordings.
    """
    names_by_text: dict[str, list[str]] = {}
    for line in warnings:
        name, _, what = line.partition(": ")
        if name in names:
            names_by_text.setdefault(what, []).append(name)
        else:
            names_by_text.setdefault(line[0].upper() + line[1:], [])
    out = []
    for what, whose in names_by_text.items():
        more = f" and {len(whose) - _NAMED} more" if len(whose) > _NAMED else ""
        out.append(f"{', '.join(whose[:_NAMED])}{more}: {what}" if whose else what)
    return out


def method_table(ctx: Context, columns: Mapping[str, Odometry], fresh: Driven) -> None:
    """Add a table of the errors of the validation run under every method's parameters."""
    rows: list[list[Any]] = []
    for name, odometry in columns.items():
        table: Any = evaluate(odometry.tracks(fresh.recordings))
        rows.append([name, *(f"{1e3 * row['rmse_position_m']:.2f}" for row in table["motions"].values())])
    motions = list(dict.fromkeys(r.motion.replace("_", " ") for r in fresh.recordings))
    ctx.table(
        "Validation run under every method's parameters: position RMSE (mm)",
        ["parameters", *motions],
        rows,
        "Motions driven with the result; the other rows only re-compute odometry from the same wheels.",
    )


def round_table(ctx: Context, runs: Sequence[Driven]) -> None:
    """Add a table of the errors of every round by motion."""
    motions = list(dict.fromkeys(r.motion for r in runs[0].recordings))
    rows: list[list[Any]] = []
    for run in runs:
        table: Any = evaluate(run.tracks())
        found = table["motions"]
        cells = (f"{1e3 * found[m]['rmse_position_m']:.2f}" if m in found else "–" for m in motions)
        rows.append([run.label, len(run.recordings), *cells, f"{1e3 * table['mean']['rmse_position_m']:.2f}"])
    ctx.table(
        "Rounds: position RMSE (mm) with the parameters that drove them",
        ["round", "recordings", *(m.replace("_", " ") for m in motions), "mean"],
        rows,
    )


def observable_table(ctx: Context, result: Calibration) -> None:
    """Add a table of the parameter combinations that the recordings determine, with their information."""
    pairs = zip(result.spectrum.directions, result.spectrum.information, strict=False)
    rows = [[k, words, f"{value:.3g}"] for k, (words, value) in enumerate(pairs, start=1)]
    ctx.table(
        "What the data determine",
        ["", "combination (of 1 % or 1 deg)", "data / prior information"],
        rows,
        "Wheels are always commanded together, so recordings show only these combinations; everything else "
        "stays where the prior puts it.",
    )


def parameter_table(ctx: Context, columns: Mapping[str, Odometry], result: Calibration) -> None:
    """Add Table I: wheel parameters by method, with the standard errors of the result."""
    z_std = result.intervals.std.reshape(4, 4)
    rows = []
    quantities = (
        ("x_w (mm)", "x_m", 1e3),
        ("y_w (mm)", "y_m", 1e3),
        ("r (mm)", "radius_m", 1e3),
        ("steering zero (deg)", "steering_zero_rad", float(np.degrees(1.0))),
    )
    for (label, key, scale), stds in zip(quantities, z_std, strict=True):
        for wheel in range(4):
            values = [getattr(o.geometry, key)[wheel] * scale for o in columns.values()]
            name, unit = label.split(" (")
            rows.append(
                [f"{name} {wheel + 1} ({unit}", *(f"{v:.3f}" for v in values), f"{stds[wheel] * scale:.3f}"]
            )
    ctx.table(
        "Table I: wheel parameters",
        ["parameter", *columns, "std"],
        rows,
        "Wheels 1 to 4 are FL, BL, BR, FR. Effective values: motions determine combinations, not each alone.",
    )


def error_table(ctx: Context, title: str, table: Any) -> None:
    """Add Table II or III: largest and mean-of-largest errors by motion."""
    keys = ("e_x_m", "e_x_a", "e_y_m", "e_y_a", "e_theta_m", "e_theta_a")
    rows = [
        [
            m.replace("_", " "),
            *(f"{row[k]:.4f}" for k in keys),
            f"{1e3 * row['rmse_position_m']:.2f}",
            f"{np.degrees(row['rmse_theta_rad']):.3f}",
        ]
        for m, row in table["motions"].items()
    ]
    head = ["motion", "e_x,m", "e_x,a", "e_y,m", "e_y,a", "e_θ,m", "e_θ,a", "RMSE mm", "RMSE deg"]
    ctx.table(
        title,
        head,
        rows,
        "m and rad; m: largest of any repetition, a: mean over the repetitions of each one's largest.",
    )


def draw_rounds(ctx: Context, runs: Sequence[Driven]) -> None:
    """Draw the position error of every round and of the validation run, with the parameters of that drive."""
    figure = new_figure(4.6, 2.6)
    axes = style(figure.add_subplot(), "", "position RMSE (mm)")
    rng = np.random.default_rng(0)
    for k, run in enumerate(runs):
        values = 1e3 * run.rmse_m()
        colour = SERIES[1] if k == 0 else SERIES[2] if run is runs[-1] else SERIES[0]
        axes.plot(k + rng.uniform(-0.18, 0.18, len(values)), values, ".", color=colour, ms=4, alpha=0.55)
        axes.plot([k - 0.3, k + 0.3], [values.mean()] * 2, color=colour, lw=2)
        axes.annotate(f" {values.mean():.2f}", (k + 0.3, values.mean()), va="center", fontsize=8)
    plain_log(axes)
    axes.set_xlim(-0.5, len(runs) - 0.2)
    axes.set_xticks(range(len(runs)), [r.label for r in runs], fontsize=8)
    ctx.figure(
        figure,
        "Rounds",
        "One point per recording, the line is the mean. Each round was driven with the parameters found "
        "by the rounds before it, so none is judged on what it was fitted to.",
    )


def draw_validation(ctx: Context, before: Sequence[Track], after: Sequence[Track]) -> None:
    """Draw paths and errors of the validation run, with the parameters before and after."""
    motions = list(dict.fromkeys(t.recording.motion for t in after))
    columns = 2
    rows = -(-len(motions) // columns)
    paths, errors = new_figure(5.2, 2.1 * rows), new_figure(5.2, 1.8 * rows)
    for k, motion in enumerate(motions, start=1):
        own = [(b, a) for b, a in zip(before, after, strict=True) if a.recording.motion == motion]
        _paths(paths.add_subplot(rows, columns, k), motion, *own[0], first=k == 1)
        axes = style(errors.add_subplot(rows, columns, k), "time (s)", "error (mm)", motion.replace("_", " "))
        for number, (b, a) in enumerate(own):
            for run, colour, name in ((b, SERIES[1], "before"), (a, SERIES[0], "after")):
                t_s, size = thin(run.t_s, 1e3 * np.hypot(run.error[:, 0], run.error[:, 1]))
                label = name if number == 0 and k == 1 else None
                axes.plot(t_s, size, color=colour, lw=1.1, label=label)
        plain_log(axes, linear_below=1.0)
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
        (after.truth, PALETTE["truth"], 2.0, "truth"),
        (before.odometry, SERIES[1], 1.1, "before"),
        (after.odometry, SERIES[0], 1.1, "after"),
    ):
        line = thin(after.t_s, np.degrees(pose[:, 2])) if turning else thin(pose[:, 0], pose[:, 1])
        axes.plot(*line, color=colour, lw=width, label=name if first else None)
    if motion.startswith("circle"):
        axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
