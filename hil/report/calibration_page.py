"""The pages of an evaluation and of a calibration: errors of odometry before and after."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.calibration.calibrate import Calibration
from hil.calibration.evaluation import Track, evaluate, track_all
from hil.calibration.problem import PARAMETER_NAMES
from hil.report.overview import Drawn, Overview, Table, write_overview_folder
from hil.report.page_formats import number
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, plain_log, style, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Kind = tuple[Sequence[Track], str, str]
"""Tracks of one kind, with their colour and name."""
_DEG = math.degrees(1.0)
_LENGTHS = 12
_MOST_REACH = 6.0
"""Largest axis range of the parameter figure, as a multiple of the found and allowed values."""
_ALLOWED = {False: "how far off a part may be by its drawing", True: "how far the fit may go"}


def write_evaluation_page(
    folder: Path,
    tracks: Sequence[Track],
    nominal: Sequence[Track] | None,
    table: Mapping[str, Any],
    notes: Sequence[str] = (),
) -> Path:
    """Write figures and `index.html` of an error table; return the page's path.

    Args:
        folder: folder of the page.
        tracks: evaluated odometry of each recording.
        nominal: odometry with nominal parameters; None if `tracks` use them.
        table: the result of `hil evaluate`, JSON values.
        notes: remarks about the calibration, one line each.

    Raises:
        DataError: a file cannot be written.
    """
    before = nominal if nominal is not None else tracks
    worst, row = max(table["motions"].items(), key=lambda m: float(m[1]["rmse_position_m"]))
    sentence = (
        f"Odometry errs by {_mm(table['mean'])} mm on average over its motions (RMSE of position), "
        f"by {_mm(row)} mm on the worst, {_words(worst)}."
    )
    if nominal is not None:
        sentence += f" With nominal parameters it errs by {_mm(dict[str, Any](evaluate(before))['mean'])} mm."
    facts = [
        f"model {table['model']}, signal {table['signal']}, cost J {number(table['cost'])}",
        *(notes or ["nominal parameters"]),
    ]
    page = Overview(
        f"Odometry of {table['recordings']} recordings",
        sentence,
        _motion_figures(before, tracks if nominal is not None else None),
        [_error_table("Errors", table)],
        table.get("warnings", []),
        facts,
    )
    return write_overview_folder(folder, page)


def write_calibration_page(folder: Path, result: Calibration) -> Path:
    """Write figures and `index.html` of a calibration; return the page's path.

    Raises:
        DataError: a file cannot be written.
    """
    setting = result.setting
    before = track_all(result.recordings, result.nominal, setting.model, setting.signal)
    after = track_all(result.recordings, result.geometry, setting.model, setting.signal)
    tables = (evaluate(before), evaluate(after))
    facts = [
        f"method {result.method}, setting {setting.name}, model {setting.model}, signal {setting.signal}",
        f"cost J {number(result.cost_before)} before, {number(result.cost_after)} after",
        f"nominal robot: {result.robot.in_words()}",
        result.compared.in_words(),
        *result.choice_in_words(),
    ]
    figures = [
        *_motion_figures(before, after),
        _parameters(result),
        Drawn(
            "weights",
            "Weights of the recordings",
            _weights(result),
            "Red: left out." if result.rejected else "No recording was left out.",
        ),
        Drawn(
            "correlation",
            "Correlation of the estimates",
            _correlation(result),
            "Strong colours: only the combination of two parameters is known, not each of them.",
        ),
    ]
    page = Overview(
        f"Calibration on {len(result.recordings)} recordings",
        _sentence(tables, result),
        figures,
        [
            *_validation_tables(result),
            _error_table("Errors before", tables[0], shown=False),
            _error_table("Errors after", tables[1], shown=False),
        ],
        result.warnings,
        facts,
    )
    return write_overview_folder(folder, page)


def _sentence(tables: tuple[Mapping[str, Any], Mapping[str, Any]], result: Calibration) -> str:
    """Return a summary: improvement on the consistent recordings, and which recordings were left out."""
    first, then = (_mm(table["mean"]) for table in tables)
    text = f"Calibration brings the mean position error of odometry from {first} to {then} mm (RMSE)"
    unseen = result.validation.get("leave_one_repetition_out")
    if not unseen:
        text += " on the recordings that it was fitted to."
    else:
        mean = float(np.mean([row["rmse_position_m"] for row in unseen.values()]))
        text += f"; on recordings that the fit did not see it is {1e3 * mean:.1f} mm."
    bad = list(result.rejected)
    if bad:
        of = f"{len(bad)} of {len(bad) + len(result.recordings)} recordings"
        text += f" Left out: {of}, {', '.join(bad)} (see the warnings)."
    return text


def _mm(row: Mapping[str, Any]) -> str:
    return f"{1e3 * float(row['rmse_position_m']):.1f}"


def _words(motion: str) -> str:
    return motion.replace("_", " ")


def _motion_figures(before: Sequence[Track], after: Sequence[Track] | None) -> list[Drawn]:
    """Draw end, position and heading errors for each motion; errors, because the paths would overlap."""
    kinds = [(before, SERIES[1], "before" if after is not None else "odometry")]
    kinds += [(after, SERIES[0], "after")] if after is not None else []
    return [
        Drawn(
            "ends",
            "Where odometry ends",
            _per_motion(kinds, _draw_ends),
            "Odometry minus ground truth at the end of each recording; zero is right.",
        ),
        Drawn(
            "position",
            "Position errors",
            _per_motion(kinds, _draw_position),
            "Distance of odometry from ground truth; logarithmic above 1 mm.",
        ),
        Drawn("heading", "Heading errors", _per_motion(kinds, _draw_heading), "Odometry minus ground truth."),
    ]


def _per_motion(kinds: Sequence[Kind], draw: Callable[[Axes, Sequence[Kind]], None]) -> Figure:
    motions = list(dict.fromkeys(t.recording.motion for t in kinds[0][0]))
    columns = min(2, len(motions))
    rows = -(-len(motions) // columns)
    figure = new_figure(5.2 if columns > 1 else 3.4, 2.1 * rows)
    for k, motion in enumerate(motions, start=1):
        axes = style(figure.add_subplot(rows, columns, k), "", "", _words(motion))
        own = [([t for t in tracks if t.recording.motion == motion], *look) for tracks, *look in kinds]
        draw(axes, own)  # type: ignore[arg-type]
        if k == 1:
            legend(axes)
    return figure


def _draw_ends(axes: Axes, kinds: Sequence[Kind]) -> None:
    axes.axhline(0.0, color=PALETTE["reference"], lw=0.8)
    axes.axvline(0.0, color=PALETTE["reference"], lw=0.8)
    for tracks, colour, label in kinds:
        ends = 1e3 * np.array([t.error[-1, :2] for t in tracks]).reshape(-1, 2)
        axes.plot(ends[:, 0], ends[:, 1], "o", ms=4, color=colour, mec="none", label=label)
    axes.set_xlabel("x error (mm)", fontsize=9)
    axes.set_ylabel("y error (mm)", fontsize=9)
    axes.margins(0.15)


def _draw_position(axes: Axes, kinds: Sequence[Kind]) -> None:
    for tracks, colour, label in kinds:
        for k, run in enumerate(tracks):
            distance = np.hypot(run.error[:, 0], run.error[:, 1]) * 1e3
            axes.plot(*thin(run.t_s, distance), color=colour, lw=1.0, label=label if k == 0 else None)
    axes.set_xlabel("time (s)", fontsize=9)
    axes.set_ylabel("error (mm)", fontsize=9)
    plain_log(axes, linear_below=1.0)


def _draw_heading(axes: Axes, kinds: Sequence[Kind]) -> None:
    for tracks, colour, label in kinds:
        for k, run in enumerate(tracks):
            heading = np.degrees(run.error[:, 2])
            axes.plot(*thin(run.t_s, heading), color=colour, lw=1.0, label=label if k == 0 else None)
    axes.set_xlabel("time (s)", fontsize=9)
    axes.set_ylabel("error (deg)", fontsize=9)


def _parameters(result: Calibration) -> Drawn:
    """Draw found and allowed parameters; an interval that exceeds the axes ends in an arrow."""
    problem, z = result.fit.problem, result.fit.solution.z
    unit = np.where(np.arange(len(z)) < _LENGTHS, 0.01 * problem.sizes, np.radians(1.0))
    change = (z - problem.nominal) / unit
    half = result.intervals.quantile * result.intervals.std / unit
    half = np.where(np.isfinite(half), half, np.inf)
    bounded = problem.setting.bounds is not None
    allowed = (problem.upper - problem.nominal if bounded else problem.prior_std) / unit
    farthest = _MOST_REACH * float(np.max([np.abs(change), allowed]))
    limit = 1.05 * min(farthest, float(np.max([np.abs(change) + half, allowed])))
    figure = new_figure(5.2, 2.9)
    axes = style(figure.add_subplot(), "", "change (% or deg)")
    at = np.arange(len(z))
    grey = "bounds" if bounded else "prior, one sigma"
    axes.bar(at, 2 * allowed, bottom=-allowed, color=PALETTE["grid"], width=0.8, label=grey)
    ends = np.clip([change - half, change + half], -limit, limit)
    axes.errorbar(
        at, change, np.abs(ends - change), fmt="o", ms=4, color=SERIES[0], capsize=3, label="fit, 95 %"
    )
    cut = [at[change - half < -limit], at[change + half > limit]]
    for where, edge, caret in zip(cut, (-limit, limit), (7, 6), strict=True):
        axes.plot(where, np.full(len(where), edge), ls="", marker=caret, ms=7, color=SERIES[0])
    axes.set_xticks(at, PARAMETER_NAMES[: len(z)], rotation=60, fontsize=8)
    axes.set_ylim(-limit, limit)
    axes.axhline(0.0, color=PALETTE["truth"], lw=0.6)
    legend(axes, columns=2, above=True)
    caption = (
        "Change from the nominal robot: 1 is 1 % of a wheel's radius or of its offset from the centre, or "
        f"1 deg of a steering zero. Bars are 95 % intervals; grey is {_ALLOWED[bounded]}."
    )
    if any(map(len, cut)):
        caption += " Arrows: the interval goes on beyond the frame."
    return Drawn("parameters", "Parameters", figure, caption)


def _correlation(result: Calibration) -> Figure:
    problem, z = result.fit.problem, result.fit.solution.z
    _, _, hessian = problem.gradient_terms(z)
    scale = 1.0 / problem.prior_std
    covariance = np.linalg.pinv(hessian / np.outer(scale, scale) + 1e-9 * np.eye(len(z)))
    spread = np.sqrt(np.diag(covariance))
    figure = new_figure(5.0, 4.0)
    axes = figure.add_subplot()
    image = axes.imshow(covariance / np.outer(spread, spread), cmap="RdBu_r", vmin=-1, vmax=1)
    names = PARAMETER_NAMES[: len(z)]
    axes.set_xticks(range(len(z)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(z)), names, fontsize=8)
    figure.colorbar(image, ax=axes, label="correlation")
    return figure


def _weights(result: Calibration) -> Figure:
    problem = result.fit.problem
    names = [*problem.blocks.names, *result.rejected]
    figure = new_figure(5.2, 2.6)
    axes = style(figure.add_subplot(), "", "weight in the fit")
    axes.bar(range(len(problem.weights)), problem.weights, color=SERIES[0])
    for k in range(len(problem.weights), len(names)):
        axes.axvspan(k - 0.4, k + 0.4, color=SERIES[4], alpha=0.4, lw=0)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    for k in range(len(problem.weights), len(names)):
        axes.get_xticklabels()[k].set_color(SERIES[4])
    axes.set_ylim(0, 1.05)
    return figure


def _error_table(title: str, table: Mapping[str, Any], *, shown: bool = True) -> Table:
    axes = (("x", 1e3, "mm"), ("y", 1e3, "mm"), ("theta", _DEG, "deg"))
    columns = [
        (f"e_{axis}_{which}", f"{sign} {words} ({unit})", factor)
        for axis, factor, unit in axes
        for which, words in (("m", "largest"), ("a", "mean"))
        for sign in (axis if axis != "theta" else "θ",)
    ]
    columns += [("rmse_position_m", "RMSE (mm)", 1e3), ("rmse_theta_rad", "RMSE (deg)", _DEG)]
    rows = [
        [_words(m), *(f"{factor * row[key]:.{1 if factor == 1e3 else 2}f}" for key, _, factor in columns)]
        for m, row in table["motions"].items()
    ]
    note = "The largest error of each recording: its largest and mean over the repetitions."
    return Table(title, ["motion", *(label for _, label, _ in columns)], rows, note, shown)


def _validation_tables(result: Calibration) -> list[Table]:
    if not result.validation:
        return []
    motions = list(result.validation["nominal"])
    rows = [
        [
            _words(name),
            *(
                f"{table[m]['rmse_position_m'] * 1e3:.1f} / {_DEG * table[m]['rmse_theta_rad']:.2f}"
                if m in table
                else "–"
                for m in motions
            ),
        ]
        for name, table in result.validation.items()
    ]
    title = "Validation: position RMSE (mm) / heading RMSE (deg)"
    return [Table(title, ["", *map(_words, motions)], rows)]
