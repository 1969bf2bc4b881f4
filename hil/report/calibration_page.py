"""Figures of an evaluation or a calibration, as PNG files and in one self-contained HTML page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader
from matplotlib.figure import Figure

from hil.calibration.calibrate import Calibration
from hil.calibration.evaluation import Track, evaluate, track
from hil.calibration.problem import PARAMETER_NAMES
from hil.vocabulary.files import staged, write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRUTH, _BEFORE, _AFTER = "#3f3f46", "#d97706", "#2563eb"
_DPI = 110


def write_evaluation_page(
    folder: Path, tracks: Sequence[Track], nominal: Sequence[Track] | None, table: Mapping[str, Any]
) -> Path:
    """Write figures and `index.html` of an error table; returns the page's path.

    Args:
        folder: to write into.
        tracks: odometry of each recording as judged.
        nominal: the same with nominal parameters; None when `tracks` are these.
        table: the result of `hil evaluate`, JSON values.
    """
    before = nominal if nominal is not None else tracks
    figures = _path_figures(before, tracks if nominal is not None else None)
    calibrated = table.get("calibration")
    title = f"Odometry of {table['recordings']} recordings"
    facts = [f"model {table['model']}, signal {table['signal']}, cost J = {table['cost']:.2f}"]
    facts.append(f"calibration: {calibrated}" if calibrated else "nominal parameters")
    return _write(folder, title, facts, table.get("warnings", []), [_error_table("errors", table)], figures)


def write_calibration_page(folder: Path, result: Calibration) -> Path:
    """Write figures and `index.html` of a calibration; returns the page's path."""
    setting = result.setting
    before = [track(r, result.nominal, setting.model, setting.signal) for r in result.recordings]
    after = [track(r, result.geometry, setting.model, setting.signal) for r in result.recordings]
    figures = _path_figures(before, after)
    figures["parameters"] = _parameters(result)
    figures["correlation"] = _correlation(result)
    figures["weights"] = _weights(result)
    facts = [
        f"method {result.method}, setting {setting.name}, model {setting.model}, signal {setting.signal}",
        f"cost J {result.cost_before:.2f} before, {result.cost_after:.2f} after; without the rejected "
        f"recordings {result.kept_cost[0]:.2f} and {result.kept_cost[1]:.2f}",
        f"robot on paper: {result.robot.in_words()}",
    ]
    tables = [
        _error_table("Before", evaluate(before)),
        _error_table("After", evaluate(after)),
        *_validation_tables(result),
    ]
    title = f"Calibration on {len(result.recordings)} recordings"
    return _write(folder, title, facts, result.warnings, tables, figures)


def _path_figures(before: Sequence[Track], after: Sequence[Track] | None) -> dict[str, Figure]:
    motions = list(dict.fromkeys(t.recording.motion for t in before))
    columns = min(3, len(motions))
    rows = -(-len(motions) // columns)
    paths, errors = (Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained") for _ in range(2))
    for k, motion in enumerate(motions, start=1):
        _draw_paths(paths.add_subplot(rows, columns, k), motion, before, after)
        _draw_errors(errors.add_subplot(rows, columns, k), motion, before, after)
    return {"paths": paths, "errors": errors}


def _draw_paths(axes: Axes, motion: str, before: Sequence[Track], after: Sequence[Track] | None) -> None:
    kinds = [(before, _BEFORE, "before" if after is not None else "odometry"), (after or [], _AFTER, "after")]
    own = [t for t in before if t.recording.motion == motion]
    turning = motion.startswith("rotation")
    for k, run in enumerate(own):
        pose = run.truth
        line = (run.t_s, np.degrees(pose[:, 2])) if turning else (pose[:, 0], pose[:, 1])
        axes.plot(*line, color=_TRUTH, lw=2.2, label="ground truth" if k == 0 else None)
    for tracks, colour, label in kinds:
        for k, run in enumerate(t for t in tracks if t.recording.motion == motion):
            pose = run.odometry
            line = (run.t_s, np.degrees(pose[:, 2])) if turning else (pose[:, 0], pose[:, 1])
            axes.plot(*line, color=colour, lw=1.0, label=label if k == 0 else None)
    axes.set_title(motion, fontsize=10)
    axes.set_xlabel("time (s)" if turning else "x (m)")
    axes.set_ylabel("heading (deg)" if turning else "y (m)")
    if motion.startswith("circle"):
        axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)


def _draw_errors(axes: Axes, motion: str, before: Sequence[Track], after: Sequence[Track] | None) -> None:
    for tracks, colour, label in ((before, _BEFORE, "before"), (after or [], _AFTER, "after")):
        for k, run in enumerate(t for t in tracks if t.recording.motion == motion):
            distance = np.hypot(run.error[:, 0], run.error[:, 1]) * 1e3
            axes.plot(run.t_s, distance, color=colour, lw=1.0, label=label if k == 0 else None)
    axes.set_title(motion, fontsize=10)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("position error (mm)")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)


def _parameters(result: Calibration) -> Figure:
    z, nominal = result.fit.solution.z, result.fit.problem.nominal
    unit = np.where(np.arange(len(z)) < 12, 0.01 * result.fit.problem.sizes, np.radians(1.0))
    half = np.nan_to_num(result.intervals.quantile * result.intervals.std / unit)
    prior = result.fit.problem.prior_std / unit
    figure = Figure(figsize=(8.4, 3.4), layout="constrained")
    axes = figure.add_subplot()
    at = np.arange(len(z))
    axes.bar(at, 2 * prior, bottom=-prior, color="#e4e4e7", width=0.8, label="prior, one sigma")
    axes.errorbar(at, (z - nominal) / unit, half, fmt="o", color=_AFTER, capsize=3, label="fit, 95 %")
    axes.set_xticks(at, PARAMETER_NAMES[: len(z)], rotation=60, fontsize=8)
    axes.set_ylabel("change (1 % of length, or 1 deg)")
    limit = 1.2 * float(np.max(np.abs((z - nominal) / unit)) + max(1.0, float(np.max(prior))))
    axes.set_ylim(-limit, limit)
    axes.axhline(0.0, color=_TRUTH, lw=0.6)
    axes.legend(fontsize=8)
    return figure


def _correlation(result: Calibration) -> Figure:
    problem, z = result.fit.problem, result.fit.solution.z
    _, _, hessian = problem.gradient_terms(z)
    scale = 1.0 / problem.prior_std
    covariance = np.linalg.pinv(hessian / np.outer(scale, scale) + 1e-9 * np.eye(len(z)))
    spread = np.sqrt(np.diag(covariance))
    figure = Figure(figsize=(6.8, 5.4), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(covariance / np.outer(spread, spread), cmap="RdBu_r", vmin=-1, vmax=1)
    names = PARAMETER_NAMES[: len(z)]
    axes.set_xticks(range(len(z)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(z)), names, fontsize=8)
    figure.colorbar(image, ax=axes, label="correlation of the estimates")
    return figure


def _weights(result: Calibration) -> Figure:
    problem = result.fit.problem
    names = problem.blocks.names
    figure = Figure(figsize=(8.4, 2.8), layout="constrained")
    axes = figure.add_subplot()
    colours = ["#dc2626" if n in result.fit.rejected else _AFTER for n in names]
    axes.bar(range(len(names)), problem.weights, color=colours)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_ylabel("weight in the fit")
    axes.set_ylim(0, 1.05)
    return figure


def _error_table(title: str, table: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("e_x_m", "e_x_a", "e_y_m", "e_y_a", "e_theta_m", "e_theta_a")
    rows = [
        [m, *(f"{row[k]:.4f}" for k in keys), f"{row['rmse_position_m'] * 1e3:.2f}",
         f"{np.degrees(row['rmse_theta_rad']):.2f}"]
        for m, row in table["motions"].items()
    ]  # fmt: skip
    return {"title": title, "head": ["motion", *keys, "RMSE mm", "RMSE deg"], "rows": rows}


def _validation_tables(result: Calibration) -> list[dict[str, Any]]:
    if not result.validation:
        return []
    motions = list(result.validation["nominal"])
    rows = [
        [name.replace("_", " "), *(
            f"{table[m]['rmse_position_m'] * 1e3:.1f} / {np.degrees(table[m]['rmse_theta_rad']):.2f}"
            if m in table else "" for m in motions
        )]
        for name, table in result.validation.items()
    ]  # fmt: skip
    title = "Validation: position RMSE (mm) / heading RMSE (deg)"
    return [{"title": title, "head": ["", *motions], "rows": rows}]


def _write(
    folder: Path, title: str, facts: Sequence[str], warnings: Sequence[str],
    tables: Sequence[Mapping[str, Any]], figures: Mapping[str, Figure],
) -> Path:  # fmt: skip
    images = []
    with staged(folder) as parts:
        for name, figure in figures.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=_DPI, bbox_inches="tight")
            (parts / f"{name}.png").write_bytes(buffer.getvalue())
            images.append((name, base64.b64encode(buffer.getvalue()).decode("ascii")))
        environment = Environment(loader=PackageLoader("hil.report", "templates"), autoescape=True)
        page = environment.get_template("calibration.html").render(
            title=title, facts=facts, warnings=warnings, tables=tables, images=images
        )
        write_text(parts / "index.html", page)
    return folder / "index.html"
