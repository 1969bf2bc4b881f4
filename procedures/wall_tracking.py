"""Lines and a scan on the wall with feedback from odometry, EKF and UKF: compares their slip and sag.

Every case starts from the same pose, in a world of the same seed. Truth is motion capture. The limits
follow from the paper's experiments (arXiv 2509.04016). Limits on means apply to several seeds: in a single
world the result depends mainly on the camera's scale, which is drawn once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.core.geometry import ArrayLike
from hil.core.known_names import ESTIMATORS, EstimatorName
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.tracking_errors import (
    belief_figure,
    check_references,
    enable_hold,
    error_figure,
    path_figure,
    series,
    tracking_errors,
    unseen,
)
from hil.procedure.worker_processes import Workers
from hil.robot.trajectories import Trajectory, line, scan

_FILTERS = {"ekf": "the EKF", "ukf": "the UKF"}
_LINES = (("x_line", "Up the wall", "short", "shortfall"), ("y_line", "Across it", "too low", "sag"))
Case = Literal["x_line", "y_line", "scan"]
World = dict[str, Any]
"""Results of the drives of one seed by label: `errors`, and for the first seed `series`."""
_SEEDS_FOR_MEANS = 5
_RESOLVED_MM = 0.1
_TRUE = "Truth from motion capture, by feedback; where a note says so, from the estimate."
_NAMES = {"x_line": "X line", "y_line": "Y line", "scan": "Scan"}


class Parameters(BaseModel):
    """Paths and feedbacks; `seeds` is the number of worlds, the first with the run's own seed."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    cases: tuple[Case, ...] = Field(
        ("x_line", "y_line"), description="Paths that are driven: x_line up the wall, y_line across it, scan."
    )
    feedbacks: tuple[EstimatorName, ...] = Field(
        ESTIMATORS, description="Estimators whose pose the controller follows, one drive each."
    )
    optimal: bool = Field(True, description="Drive the line across the wall with the optimal law as well.")
    length_m: float = Field(1.5, gt=0, le=3.0, description="Length of the lines, m.")
    duration_s: float = Field(30.0, gt=1.0, le=3600, description="How long a line takes, s.")
    lanes: int = Field(5, ge=1, le=20, description="How many lanes the scan has.")
    lane_length_m: float = Field(1.0, gt=0, description="Length of a lane of the scan, m.")
    lane_spacing_m: float = Field(
        0.1, gt=0, description="Distance between neighbouring lanes of the scan, m."
    )
    scan_speed_m_s: float = Field(0.1, gt=0, le=3.5, description="Speed of the scan, m/s.")
    hold_s: float = Field(
        2.0, ge=0.5, le=600, description="How long the robot stands at the end before it is measured, s."
    )
    seeds: int = Field(
        1,
        ge=1,
        le=100,
        description="How many emulated worlds are driven, the first with the seed of the run.",
    )
    processes: int = Field(1, ge=1, le=8, description="How many drives go on at once; in virtual time only.")

    @model_validator(mode="after")
    def _something(self) -> Parameters:
        if not self.cases or not self.feedbacks:
            raise ValueError("nothing to drive: cases and feedbacks must not be empty")
        return self


@dataclass(frozen=True)
class Drive:
    """One drive with its feedback and control law."""

    case: str
    feedback: str
    law: str

    @property
    def label(self) -> str:
        """Short name, also used for its recording."""
        return f"{self.case} {'optimal' if self.law == 'optimal' else self.feedback}"


def drives(p: Parameters) -> list[Drive]:
    """Return all drives of one seed; the optimal law is compared with the non-linear one on the Y line."""
    found = [Drive(c, f, "nonlinear") for c in p.cases for f in p.feedbacks]
    if p.optimal and "y_line" in p.cases and "ekf" in p.feedbacks:
        found.append(Drive("y_line", "ekf", "optimal"))
    return found


def reference(case: str, p: Parameters, start: ArrayLike) -> Trajectory:
    """Return the reference of a case from the robot's pose `start`."""
    pose = np.asarray(start, dtype=np.float64)
    if case == "scan":
        return scan(pose, p.lane_length_m, p.lanes, p.lane_spacing_m, speed_m_s=p.scan_speed_m_s)
    step_m = np.array([p.length_m, 0, 0]) if case == "x_line" else np.array([0, p.length_m, 0])
    return line(pose, pose + step_m, duration_s=p.duration_s, name=case)


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the limits for 1.5 m on melamine; odometry, which should fail as in the paper, has none."""
    for case in p.cases:
        for feedback in p.feedbacks:
            yield from _of_odometry(case) if feedback == "odometry" else _of_filter(case, feedback, p)
    if Drive("y_line", "ekf", "optimal") in drives(p):
        yield Measurement("y_line.optimal.rmse_x_worst", "mm", high=15.0, rationale="worst seed")
        yield Measurement(
            "y_line.optimal.cross_track_ratio",
            "1",
            rationale="cross-track RMSE, optimal law with integral action over non-linear law",
        )


def _of_odometry(case: str) -> Iterator[Measurement]:
    name, mean = f"{case}.odometry", "mean over the seeds"
    if case == "scan":
        yield Measurement(f"{name}.rmse_worse_axis", "mm", rationale=f"above 50 in the paper; {mean}")
        return
    if case == "x_line":
        yield Measurement(f"{name}.shortfall", "mm", rationale=f"above 30 over 1.5 m in the paper; {mean}")
    else:
        yield Measurement(f"{name}.sag", "mm", rationale=f"above 20 over 1.5 m in the paper; {mean}")
    yield Measurement(f"{name}.heading_drift", "deg", rationale=f"above 1 over 1.5 m in the paper; {mean}")


def _mean(p: Parameters) -> str:
    return "mean over the seeds" if p.seeds >= _SEEDS_FOR_MEANS else "too few worlds for a limit"


def _of_filter(case: str, feedback: str, p: Parameters) -> Iterator[Measurement]:
    name, several = f"{case}.{feedback}", p.seeds >= _SEEDS_FOR_MEANS
    high, mean = 6.0 if case == "scan" else 8.0, _mean(p)
    for axis in ("x", "y"):
        yield Measurement(
            f"{name}.rmse_{axis}",
            "mm",
            high=high if several else None,
            marginal=1.0 if several else 0.0,
            rationale=mean,
        )
        yield Measurement(f"{name}.rmse_{axis}_worst", "mm", high=15.0, rationale="worst seed")
    if case == "scan":
        return
    yield Measurement(
        f"{name}.end", "mm", high=25.0, marginal=3.0, rationale="distance at the end, worst seed"
    )
    yield Measurement(f"{name}.rmse_heading", "deg", high=0.4, marginal=0.05, rationale="mean over the seeds")
    if "odometry" in p.feedbacks:
        yield Measurement(
            f"{name}.improvement",
            "1",
            rationale="shortfall (X line) or sag (Y line) of odometry over the filter's; a robot beyond its "
            f"goal has neither, see end; {mean}",
        )


def references(p: Parameters, config: BenchConfig) -> tuple[Trajectory, ...]:
    """Return the references of each world, from the configured start."""
    return tuple(reference(d.case, p, config.environment.start_pose) for d in drives(p))


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the check of the references, one step per seed, and the evaluation."""
    yield PlannedStep("check the references", references(p, config))
    for number in range(p.seeds):
        yield PlannedStep(f"world {number + 1} of {p.seeds}")
    yield PlannedStep("evaluate")


def drive(bench: Bench, one: Drive, p: Parameters) -> dict[str, Any]:
    """Drive one case on a fresh bench; return its errors and series as JSON values."""
    start = enable_hold(bench)
    motion = bench.drive(
        reference(one.case, p, start),
        controller=one.law,
        feedback=one.feedback,
        hold_s=p.hold_s,
        start_pose=start,
    )
    return {"errors": tracking_errors(motion), "series": series(motion)}


def headline(v: Mapping[str, float]) -> str:
    """Return the distances from the goal with odometry and with the filters."""
    sentences = []
    for case, where, way, lost in _LINES:
        parts = []
        if f"{case}.odometry.{lost}" in v:
            parts.append(f"odometry ends {v[f'{case}.odometry.{lost}']:.0f} mm {way}")
        ends = {name: v.get(f"{case}.{key}.end") for key, name in _FILTERS.items()}
        parts += [f"{name} {end:.1f} mm from its goal" for name, end in ends.items() if end is not None]
        sentences += [f"{where}, {', '.join(parts)}."] if parts else []
    return " ".join(sentences)


@procedure(
    name="wall_tracking",
    needs=("servos", "imu", "tracker", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
)
def run(ctx: Context) -> None:
    """Wall tracking with feedback from odometry, EKF and UKF."""
    p: Parameters = ctx.parameters
    with ctx.step("check the references"):
        check_references(ctx.source.config, references(p, ctx.source.config))
        for number in range(1, p.seeds):
            _ = ctx.source.changed(seed=ctx.seed + number).config
    worlds: list[World] = []
    ctx.on_early_end(lambda: measure(ctx, worlds))
    for number in range(p.seeds):
        worlds.append({})
        title = f"world {number + 1} of {p.seeds}"
        worlds[-1] = ctx.checkpoint(title, partial(one_world, ctx, ctx.seed + number, worlds[-1]))
    with ctx.step("evaluate"):
        measure(ctx, worlds)
        show(ctx, worlds[0])


def one_world(ctx: Context, seed: int, found: World) -> World:
    """Drive all cases in worlds of one seed; only those of the first seed are drawn.

    Args:
        ctx: context of the run.
        seed: seed of the worlds.
        found: dictionary that receives the result of each drive when it ends.

    Returns:
        `found`.
    """
    p: Parameters = ctx.parameters
    jobs = drives(p)
    _tell(ctx, seed, found)
    if p.processes > 1 and ctx.source.virtual:
        source = ctx.source.changed(seed=seed)
        drive_jobs = [DriveJob(source, partial(drive, one=one, p=p), _label(one, seed)) for one in jobs]
        with Workers(min(p.processes, len(jobs))) as workers:
            for one, result in zip(jobs, ctx.at_once(drive_jobs, workers), strict=True):
                _take(ctx, seed, found, one, result)
    else:
        for one in jobs:
            bench = ctx.reopen(_label(one, seed), seed=seed)
            _take(ctx, seed, found, one, drive(bench, one, p))
    return found


def _take(ctx: Context, seed: int, found: World, one: Drive, result: dict[str, Any]) -> None:
    found[one.label] = result if seed == ctx.seed else {"errors": result["errors"]}
    _tell(ctx, seed, found)


def _tell(ctx: Context, seed: int, found: World) -> None:
    """Report how many drives of a world, and of all worlds, are done."""
    p: Parameters = ctx.parameters
    drives_each = len(drives(p))
    whole = ((seed - ctx.seed) * drives_each + len(found), p.seeds * drives_each)
    ctx.progress(f"seed {seed}", len(found), drives_each, whole)


def _label(one: Drive, seed: int) -> str:
    return f"{one.label} seed {seed}"


def measure(ctx: Context, worlds: Sequence[World]) -> None:
    """Leave tables of all drives; set measurements of cases that were driven in every world."""
    p: Parameters = ctx.parameters
    driven = worlds[0] if worlds else {}
    errors = {
        label: {
            key: np.array([w[label]["errors"][key] for w in worlds if label in w]) for key in run["errors"]
        }
        for label, run in driven.items()
    }
    for number, world in enumerate(worlds):
        for label, run in world.items():
            if missing := unseen(run["errors"]):
                ctx.note(f"{label} seed {ctx.seed + number}: {missing}")
    whole = {k: own for k, own in errors.items() if len(own["rmse_x"]) == p.seeds}
    for case in p.cases:
        for feedback in p.feedbacks:
            if f"{case} {feedback}" in whole:
                _measure(ctx, case, feedback, whole)
    if {"y_line optimal", "y_line ekf"} <= set(whole):
        optimal, plain = whole["y_line optimal"], whole["y_line ekf"]
        ratio = optimal["rmse_x"].mean() / plain["rmse_x"].mean()
        ctx.measure("y_line.optimal.rmse_x_worst", optimal["rmse_x"].max(), _doubt(optimal))
        ctx.measure("y_line.optimal.cross_track_ratio", ratio, _doubt(optimal, plain))
    if errors:
        _table(ctx, errors)


def show(ctx: Context, world: World) -> None:
    """Leave the figures of the first world."""
    p: Parameters = ctx.parameters
    for case in p.cases:
        shown = {
            label.split()[1]: run["series"] for label, run in world.items() if label.startswith(case + " ")
        }
        name = _NAMES[case]
        ctx.figure(partial(path_figure, shown), f"{name}: path", _TRUE)
        ctx.figure(
            partial(error_figure, shown),
            f"{name}: errors",
            "Where the robot was, minus where it should have been.",
        )
        ctx.figure(
            partial(belief_figure, shown),
            f"{name}: error of the estimate",
            "Estimate minus truth: the pose of odometry follows the reference despite slip.",
        )


def _measure(ctx: Context, case: str, feedback: str, errors: dict[str, Any]) -> None:
    own, name = errors[f"{case} {feedback}"], f"{case}.{feedback}"
    lost, measure = "end_x", partial(ctx.measure, doubt=_doubt(own))
    if feedback == "odometry":
        if case == "scan":
            measure(f"{name}.rmse_worse_axis", np.maximum(own["rmse_x"], own["rmse_y"]).mean())
            return
        measure(f"{name}.{'shortfall' if case == 'x_line' else 'sag'}", (-own[lost]).mean())
        measure(f"{name}.heading_drift", np.abs(own["end_heading"]).mean())
        return
    for axis in ("x", "y"):
        measure(f"{name}.rmse_{axis}", own[f"rmse_{axis}"].mean())
        measure(f"{name}.rmse_{axis}_worst", own[f"rmse_{axis}"].max())
    if case == "scan":
        return
    measure(f"{name}.end", np.hypot(own["end_x"], own["end_y"]).max())
    measure(f"{name}.rmse_heading", own["rmse_heading"].mean())
    if f"{case} odometry" in errors:
        before, after = (np.maximum(-e[lost], 0.0).mean() for e in (errors[f"{case} odometry"], own))
        both = _doubt(errors[f"{case} odometry"], own)
        ctx.measure(f"{name}.improvement", before / max(after, _RESOLVED_MM), both)


def _doubt(*own: Mapping[str, Any]) -> str:
    """Return why the results of drives rest on something else than motion capture, or are missing."""
    return "; ".join(dict.fromkeys(text for errors in own for text in errors["doubt"] if text))


def _table(ctx: Context, errors: dict[str, Any]) -> None:
    keys = ("rmse_x", "rmse_y", "rmse_heading", "end_x", "end_y", "end_heading", "worst")
    head = ["run", "RMSE x", "RMSE y", "RMSE heading", "end x", "end y", "end heading", "largest"]
    rows = [
        [label.replace("_", " "), *(f"{own[k].mean():.2f}" for k in keys)] for label, own in errors.items()
    ]
    seeds = ctx.parameters.seeds
    note = "mm and deg, truth minus reference" + (f"; means over {seeds} seeds" if seeds > 1 else "")
    ctx.table("Errors of the true pose", head, rows, note)
    if seeds > 1:
        spread = [
            [label.replace("_", " "), *(f"{np.abs(own[k]).max():.2f}" for k in keys)]
            for label, own in errors.items()
        ]
        ctx.table("Worst seed", head, spread, "mm and deg, largest size over the seeds")
