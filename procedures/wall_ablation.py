"""Measures the effect of each part of a robot's record: wall lines with no part, with each part, with all.

Lines up and across the wall, with feedback from the filter, each from the same start, in a world of the same
seed. Limits apply to the last setting: what a lab may expect of a commissioned robot. With fewer known parts
the bench's checks may stop the robot; its line ends there.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypedDict

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.config.robot_record import PARTS
from hil.core.errors import SafetyStop
from hil.core.geometry import ArrayLike
from hil.core.signals import CycleRecord
from hil.loop.driven_motion import Motion
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.record_parts import known_parts
from hil.procedure.tracking_errors import REFERENCE_M, check_references, enable_hold, tracking_errors, unseen
from hil.procedure.worker_processes import Workers
from hil.report.ablation_figure import EVERYTHING, NOTHING, ablation_figure
from hil.robot.trajectories import Trajectory, line

_BY_WHAT_IS_NOT_KNOWN = ("sensors_disagree", "tracking", "heading")
"""Reasons of stops that may be caused by unknown parameters."""
Table = dict[str, dict[str, dict[str, float]]]
"""Setting -> line -> error, as in the JSON of `hil commission`."""


class Driven(TypedDict):
    """One line: its errors, from `tracking_errors`, and the message of the check that stopped it."""

    errors: dict[str, Any]
    stopped: str


@dataclass(frozen=True)
class Setting:
    """One setting: its name, and its known parts."""

    name: str
    known: tuple[str, ...]


def settings_of(known: Sequence[str], alone: Collection[str]) -> tuple[Setting, ...]:
    """Return the settings: nothing known; each part with those that it depends on; everything known.

    There is no separate setting for parts without a value for the bench file, which change nothing, for signs
    (without them no motion is right), and for what holds the robot.

    Args:
        known: parts of the record.
        alone: parts that are also tested separately.
    """
    if not known:
        return (Setting(NOTHING, ()),)
    single = []
    for name in known:
        if name not in alone or not PARTS[name].keys or name in ("signs", "steering", "hold"):
            continue
        below = tuple(n for n in PARTS[name].on if n in known)
        if {*below, name} == set(known):
            continue
        words = [n for n in (*below, name) if n != "signs"]
        single.append(Setting(f"{' and '.join(words)} known", (*below, name)))
    return (Setting(NOTHING, ()), *single, Setting(EVERYTHING, tuple(known)))


Case = Literal["x_line", "y_line"]
Jobs = list[tuple[Setting, Case]]


class Parameters(BaseModel):
    """Lines to drive; `single` are the parts of the record that are tested separately."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    cases: tuple[Case, ...] = Field(
        ("x_line", "y_line"), description="Lines that are driven: x_line up the wall, y_line across it."
    )
    length_m: float = Field(1.5, gt=0, le=3.0, description="Length of the lines, m.")
    duration_s: float = Field(30.0, gt=1.0, le=3600, description="How long a line takes, s.")
    hold_s: float = Field(
        1.0, ge=0.5, le=600, description="How long the robot stands at its end before it is measured, s."
    )
    single: tuple[str, ...] = Field(
        tuple(PARTS), description="Parts of the robot's record that are also tried by themselves."
    )
    processes: int = Field(2, ge=1, le=8, description="How many drives run at once; in virtual time only.")


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the limits with everything known, for 1.5 m; they scale with the length."""
    share = max(p.length_m / REFERENCE_M, 0.3)
    for case in p.cases:
        yield Measurement(
            f"{case}.nothing_known.end", "mm", rationale="distance from the goal, for comparison"
        )
        yield Measurement(
            f"{case}.end",
            "mm",
            high=8.0 * share,
            marginal=1.0 * share,
            rationale="distance from the goal with everything known; 1.5 m, worst robot of ten",
        )
        for axis in "xy":
            yield Measurement(
                f"{case}.rmse_{axis}",
                "mm",
                high=5.0 * share,
                marginal=0.5 * share,
                rationale="with everything known; twice the mean of ten robots",
            )
        yield Measurement(f"{case}.rmse_heading", "deg", high=0.2, marginal=0.05, rationale="as above")


def reference(case: str, p: Parameters, start: ArrayLike) -> Trajectory:
    """Return the line of a case from the robot's pose `start`."""
    pose = np.asarray(start, dtype=np.float64)
    step_m = np.array([p.length_m, 0, 0]) if case == "x_line" else np.array([0, p.length_m, 0])
    return line(pose, pose + step_m, duration_s=p.duration_s, name=case)


def references(p: Parameters, config: BenchConfig) -> tuple[Trajectory, ...]:
    """Return the lines from the configured start."""
    return tuple(reference(case, p, config.environment.start_pose) for case in p.cases)


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the lines of every setting, and the evaluation."""
    for setting in _settings(p, config):
        for case, way in zip(p.cases, references(p, config), strict=True):
            yield PlannedStep(f"{setting.name}, {case}", (way,))
    yield PlannedStep("evaluate")


def _settings(p: Parameters, config: BenchConfig) -> tuple[Setting, ...]:
    return settings_of(tuple(known_parts(config)), p.single)


def headline(v: Mapping[str, float]) -> str:
    """Return the end errors with everything and with nothing known."""
    sentences = []
    for case, where in (("x_line", "Up the wall"), ("y_line", "Across it")):
        if f"{case}.end" in v:
            before, after = v[f"{case}.nothing_known.end"], v[f"{case}.end"]
            sentences.append(
                f"{where}, the robot ends {after:.1f} mm from its goal; {before:.0f} with nothing known."
            )
    return " ".join(sentences)


@procedure(
    name="wall_ablation",
    needs=("servos", "imu", "tracker", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"duration_s": 26.0, "hold_s": 0.5, "single": ("camera", "slip")},
)
def run(ctx: Context) -> None:
    """The same lines on the wall with nothing known of the robot, with each part, with everything."""
    p: Parameters = ctx.parameters
    config = ctx.source.config
    check_references(config, references(p, config))
    settings = _settings(p, config)
    jobs = [(setting, case) for setting in settings for case in p.cases]
    lines: list[Driven] = []
    ctx.on_early_end(lambda: _tabulated(ctx, jobs, lines))
    if p.processes > 1 and ctx.source.virtual:
        lines[:] = ctx.checkpoint("lines", partial(_at_once, ctx, jobs, lines))
    else:
        for number, (setting, case) in enumerate(jobs, start=1):
            title = f"{setting.name}, {case}"
            may_stop = setting != settings[-1]
            lines.append(ctx.checkpoint(title, partial(_here, ctx, setting, case, may_stop=may_stop)))
            ctx.progress("lines", number, len(jobs), (number, len(jobs)))
    with ctx.step("evaluate"):
        evaluate(ctx, jobs, lines)


def drive(bench: Bench, case: str, p: Parameters, *, may_stop: bool) -> Driven:
    """Drive one line on a fresh bench.

    Args:
        bench: bench to drive.
        case: name of the line.
        p: length and times.
        may_stop: True if a failed check of sensor data ends only the line and not the run: true if not all
            parts are known, as such a line is not judged.
    """
    start = enable_hold(bench)
    way = reference(case, p, start)
    records: list[CycleRecord] = []
    try:
        motion = bench.drive(way, feedback="ekf", hold_s=p.hold_s, start_pose=start, on_cycle=records.append)
    except SafetyStop as stop:
        if not (may_stop and records and stop.reason in _BY_WHAT_IS_NOT_KNOWN):
            raise
        motion = Motion(tuple(records))
        error = motion.truth[0][-1] - way.sample(way.duration_s).pose_in_wall
        ends = {"end_x": 1e3 * error[0], "end_y": 1e3 * error[1]}
        errors = tracking_errors(motion) | {name: float(end) for name, end in ends.items()}
        return Driven(errors=errors, stopped=str(stop))
    return Driven(errors=tracking_errors(motion), stopped="")


def _without(config: BenchConfig, setting: Setting) -> dict[str, object]:
    own = config.record.without
    return {"record.without": (*own, *(n for n in PARTS if n not in setting.known and n not in own))}


def _here(ctx: Context, setting: Setting, case: str, *, may_stop: bool) -> Driven:
    bench = ctx.reopen(_label(setting, case), overrides=_without(ctx.source.config, setting))
    return drive(bench, case, ctx.parameters, may_stop=may_stop)


def _at_once(ctx: Context, jobs: Jobs, found: list[Driven]) -> list[Driven]:
    p: Parameters = ctx.parameters
    config = ctx.source.config
    judged, _ = jobs[-1]
    work = [
        DriveJob(
            ctx.source.changed(overrides=_without(config, setting)),
            partial(drive, case=case, p=p, may_stop=setting != judged),
            _label(setting, case),
        )
        for setting, case in jobs
    ]
    with Workers(min(p.processes, len(jobs))) as workers:
        for number, one in enumerate(ctx.at_once(work, workers), start=1):
            found.append(one)
            ctx.progress("lines", number, len(jobs), (number, len(jobs)))
    return found


def _label(setting: Setting, case: str) -> str:
    return f"{case} {setting.name}"


def evaluate(ctx: Context, jobs: Jobs, lines: list[Driven]) -> None:
    """Set measurements; leave the table for other programs, and the figure."""
    table = _tabulated(ctx, jobs, lines)
    ctx.leave_data("wall", table)
    ctx.figure(
        ablation_figure(table),
        "What is known, and where the robot ends",
        "Distance from the goal at the end of each line; shorter is better.",
    )


def _tabulated(ctx: Context, jobs: Jobs, lines: list[Driven]) -> Table:
    """Leave measurements and table of the driven lines, the first of the jobs; return the table."""
    table: Table = {}
    doubts: dict[tuple[str, str], str] = {}
    for (setting, case), driven in zip(jobs, lines, strict=False):
        own = driven["errors"]
        if why := driven["stopped"] or unseen(own):
            ctx.note(f"{setting.name}, {case}: {why}")
        doubts[setting.name, case] = own["doubt"]
        table.setdefault(setting.name, {})[case] = {
            "end_m": 1e-3 * float(np.hypot(own["end_x"], own["end_y"])),
            "rmse_x_m": 1e-3 * own["rmse_x"],
            "rmse_y_m": 1e-3 * own["rmse_y"],
            "rmse_heading_rad": float(np.radians(own["rmse_heading"])),
            "end_x_m": 1e-3 * own["end_x"],
            "end_y_m": 1e-3 * own["end_y"],
        }
    known = {setting.name for setting, _ in jobs}
    most = EVERYTHING if EVERYTHING in known else NOTHING
    for name, row in table.get(NOTHING, {}).items():
        ctx.measure(f"{name}.nothing_known.end", 1e3 * row["end_m"], doubts[NOTHING, name])
    for name, row in table.get(most, {}).items():
        doubt = doubts[most, name]
        ctx.measure(f"{name}.end", 1e3 * row["end_m"], doubt)
        for axis in "xy":
            ctx.measure(f"{name}.rmse_{axis}", 1e3 * row[f"rmse_{axis}_m"], doubt)
        ctx.measure(f"{name}.rmse_heading", float(np.degrees(row["rmse_heading_rad"])), doubt)
    rows = [
        [
            name,
            case.replace("_", " "),
            *(f"{1e3 * row[k]:.2f}" for k in ("end_m", "rmse_x_m", "rmse_y_m")),
            f"{np.degrees(row['rmse_heading_rad']):.3f}",
        ]
        for name, cases in table.items()
        for case, row in cases.items()
    ]
    if not rows:
        return table
    head = ["known", "line", "end (mm)", "RMSE x (mm)", "RMSE y (mm)", "RMSE heading (deg)"]
    ctx.table(
        "Lines by what is known", head, rows, "Truth minus reference; end is the distance from the goal."
    )
    return table
