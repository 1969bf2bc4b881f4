"""A boustrophedon scan of a piece of wall, as for inspection: measures whether the probe covers all of it.

Truth is motion capture. The wall is covered where a probe of the given width across the lanes, at the
body's origin, has truly been. Lanes go up and down the wall, X, and step along Y.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.config.bench import BenchConfig
from hil.core.geometry import Array, ArrayLike
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.tracking_errors import (
    belief_figure,
    check_references,
    coverage_figure,
    enable_hold,
    error_figure,
    series,
    tracking_errors,
    unseen,
)
from hil.robot.trajectories import Trajectory, scan

_CELL_M = 0.005


class Parameters(BaseModel):
    """Size of the scan and its feedback; `compare` also drives it on odometry."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    lanes: int = Field(5, ge=1, le=50, description="How many parallel lanes are driven.")
    lane_length_m: float = Field(1.0, gt=0, description="Length of a lane, m.")
    lane_spacing_m: float = Field(0.1, gt=0, description="Distance between neighbouring lanes, m.")
    speed_m_s: float = Field(0.1, gt=0, le=3.5, description="Speed along a lane, m/s.")
    probe_width_m: float = Field(
        0.12,
        gt=0,
        description="Width that the probe sees, m; wider than the distance of lanes, or gaps remain.",
    )
    feedback: Literal["ekf", "ukf"] = Field("ekf", description="Filter whose pose the controller follows.")
    law: Literal["nonlinear", "optimal"] = Field("optimal", description="Control law that follows the path.")
    compare: bool = Field(False, description="Drive the same scan on odometry as well, for comparison.")
    hold_s: float = Field(
        2.0, ge=0.5, le=600, description="How long the robot stands at its end before it is measured, s."
    )

    @model_validator(mode="after")
    def _overlapping(self) -> Parameters:
        if self.probe_width_m <= self.lane_spacing_m:
            raise ValueError(
                "probe_width_m must exceed lane_spacing_m, or the lanes leave gaps by themselves"
            )
        return self


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the requirements of an inspection; odometry must fail on a full scan."""
    why = "a scan of five lanes in simulation: EKF 3.1 and 3.7 mm, odometry 170 and 29.5"
    for axis in ("x", "y"):
        yield Measurement(f"rmse_{axis}", "mm", high=6.0, marginal=0.5, rationale=why)
    yield Measurement("rmse_heading", "deg", high=0.4, marginal=0.05)
    yield Measurement("end", "mm", high=25.0, marginal=3.0, rationale="distance at the end, after the hold")
    margin_mm = 1e3 * (p.probe_width_m - p.lane_spacing_m)
    yield Measurement("covered", "1", low=0.99, rationale=f"neighbouring lanes overlap by {margin_mm:.0f} mm")
    if p.lanes > 1:
        yield Measurement(
            "lane_spacing_error",
            "mm",
            high=max(margin_mm, 1.0),
            rationale="largest, between the means of neighbouring lanes: more would leave a gap",
        )
    if p.compare:
        yield Measurement(
            "odometry.rmse_worse_axis", "mm", rationale="for comparison: odometry suffers from slip and sag"
        )


def reference(p: Parameters, start: ArrayLike) -> Trajectory:
    """Return the scan from the robot's pose `start`."""
    return scan(start, p.lane_length_m, p.lanes, p.lane_spacing_m, speed_m_s=p.speed_m_s, name="grid scan")


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the scan, once or twice."""
    path = reference(p, config.environment.start_pose)
    yield PlannedStep("check the reference", (path,))
    yield PlannedStep("scan", (path,))
    if p.compare:
        yield PlannedStep("scan on odometry", (path,))
    yield PlannedStep("evaluate")


def headline(v: Mapping[str, float]) -> str:
    """Return the covered share of the rectangle, and the errors of the robot."""
    return (
        f"The scan saw {100.0 * v['covered']:.1f} % of its rectangle and ended {v['end']:.1f} mm from its "
        f"goal. Its RMSE is {v['rmse_x']:.1f} mm along X and {v['rmse_y']:.1f} mm along Y."
    )


@procedure(
    name="grid_scan",
    needs=("servos", "imu", "tracker", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
)
def run(ctx: Context) -> None:
    """Scan a piece of wall lane by lane."""
    p: Parameters = ctx.parameters
    with ctx.step("check the reference"):
        config = ctx.source.config
        check_references(config, [reference(p, config.environment.start_pose)])
    runs: dict[str, Any] = {p.feedback: ctx.checkpoint("scan", lambda: _drive(ctx, p, p.feedback))}
    if p.compare:
        runs["odometry"] = ctx.checkpoint("scan on odometry", lambda: _drive(ctx, p, "odometry"))
    with ctx.step("evaluate"):
        _evaluate(ctx, p, runs)


def _drive(ctx: Context, p: Parameters, feedback: str) -> dict[str, Any]:
    bench = ctx.reopen(feedback)
    start = enable_hold(bench)
    motion = bench.drive(
        reference(p, start), controller=p.law, feedback=feedback, hold_s=p.hold_s, start_pose=start
    )
    truth, _ = motion.truth
    first = int(np.argmax(np.all(np.isfinite(truth), axis=1)))
    return {
        "errors": tracking_errors(motion),
        "series": series(motion),
        "start": start.tolist(),
        "path": np.round(truth[first::5, :2], 5).tolist(),
        "lanes": lane_offsets(truth, motion.reference, start, p).tolist(),
    }


def lane_offsets(truth: Array, wanted: Array, start: ArrayLike, p: Parameters) -> Array:
    """Return the mean true Y of each lane, relative to the start, shape (lanes,), m; corners left out.

    Args:
        truth: poses (n, 3); NaN where unknown.
        wanted: reference poses (n, 3).
        start: start pose of the scan.
        p: size of the scan.
    """
    origin = np.asarray(start, dtype=np.float64)
    along, across = wanted[:, 0] - origin[0], wanted[:, 1] - origin[1]
    inner = (along > 0.05 * p.lane_length_m) & (along < 0.95 * p.lane_length_m)
    out = []
    for lane in range(p.lanes):
        on = inner & (np.abs(across - lane * p.lane_spacing_m) < 1e-6) & np.isfinite(truth[:, 1])
        out.append(truth[on, 1].mean() - origin[1] if np.any(on) else np.nan)
    return np.array(out)


def covered_cells(path: Array, start: ArrayLike, p: Parameters) -> Array:
    """Return which cells of the scanned rectangle the probe has seen, shape (along X, along Y).

    Args:
        path: true positions (n, 2) in order, m; NaN where the robot was not seen.
        start: start pose of the scan, its corner.
        p: size of scan and probe.
    """
    origin = np.asarray(start, dtype=np.float64)[:2]
    size = np.array([p.lane_length_m, max((p.lanes - 1) * p.lane_spacing_m, _CELL_M)])
    cells = np.maximum(np.round(size / _CELL_M).astype(int), 1)
    seen = np.zeros(cells, dtype=bool)
    y_m = (np.arange(cells[1]) + 0.5) * size[1] / cells[1]
    for (x0, y0), (x1, y1) in zip(path[:-1] - origin, path[1:] - origin, strict=True):
        if not math.isfinite(x0 + x1):
            continue
        low, high = sorted((x0, x1))
        first, last = np.floor(low / _CELL_M), np.ceil(high / _CELL_M)
        rows = slice(int(max(first, 0)), int(max(last, 0)))
        seen[rows] |= np.abs(y_m - 0.5 * (y0 + y1)) <= 0.5 * p.probe_width_m
    return seen


def _evaluate(ctx: Context, p: Parameters, runs: dict[str, Any]) -> None:
    own = runs[p.feedback]
    errors = own["errors"]
    for label, run in runs.items():
        if missing := unseen(run["errors"]):
            ctx.note(f"scan by {label}: {missing}")
    doubt = errors["doubt"]
    for name in ("rmse_x", "rmse_y", "rmse_heading"):
        ctx.measure(name, errors[name], doubt)
    ctx.measure("end", float(np.hypot(errors["end_x"], errors["end_y"])), doubt)
    seen = covered_cells(np.array(own["path"]), np.array(own["start"]), p)
    ctx.measure("covered", float(seen.mean()), doubt)
    if p.lanes > 1:
        gaps = np.diff(np.array(own["lanes"], dtype=np.float64)) - p.lane_spacing_m
        ctx.measure("lane_spacing_error", 1e3 * float(np.abs(gaps).max()), doubt)
    if p.compare:
        lost = runs["odometry"]["errors"]
        ctx.measure("odometry.rmse_worse_axis", max(lost["rmse_x"], lost["rmse_y"]), lost["doubt"])
    shown = {name: run["series"] for name, run in runs.items()}
    ctx.figure(
        coverage_figure(shown, seen, np.array(own["start"]), p.lane_length_m),
        "Path and coverage",
        f"Shaded: seen by a probe of {1e3 * p.probe_width_m:.0f} mm. Lines: where the robot truly went.",
    )
    ctx.figure(belief_figure(shown), "Error of the estimate", "Estimate, which was fed back, minus truth.")
    ctx.figure(error_figure(shown), "Errors", "Truth minus reference.")
    keys = ("rmse_x", "rmse_y", "rmse_heading", "worst", "saturated_s")
    ctx.table(
        "Errors of the true pose",
        ["feedback", "RMSE x", "RMSE y", "RMSE heading", "largest", "saturated (s)"],
        [[name, *(f"{run['errors'][k]:.2f}" for k in keys)] for name, run in runs.items()],
        "mm and deg, truth minus reference",
    )
