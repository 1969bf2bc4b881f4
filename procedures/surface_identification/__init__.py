"""Measures slip and sag per metre of a robot on its wall, and the heading up to which it holds.

The robot drives lines up, down, left and right; motion capture measures the slip that wheels cannot. Feedback
is a filter that holds the heading if the bench has IMU and camera, because thrust that turns with the robot
pushes it aside; otherwise odometry. Then the robot is placed on the wall at various headings, where thrust
carries less of its weight, to find the heading at which it begins to slide. A real wall needs a tether.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.bench import Bench
from hil.bench.loop_settings import adhesion_limits, thrust_wanted_n
from hil.config.bench import BenchConfig
from hil.config.robot_record import Figure
from hil.core.errors import ConfigError
from hil.core.geometry import Array
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.record_parts import leave_part
from hil.procedure.tracking_errors import STAGGER_S, enable_hold
from hil.procedure.worker_processes import Workers
from hil.procedures.surface_identification.hold import WITHOUT, hold_angle
from hil.procedures.surface_identification.slip import downhill, draw, next_lines, rate, slip_of
from hil.robot.trajectories import Trajectory, line

DIRECTIONS = ("up", "down", "left", "right")
_ALONE = (DIRECTIONS[:2], DIRECTIONS[2:])
"""Directions of a repetition that one process drives: there and back."""
_FOR_A_FILTER = ("imu", "tracker")
_SYSTEMATIC = 0.05  # starts, stops, and grip lost by turning while slipping
_FEWEST = 2  # repetitions, for a spread
_MARGIN_DEG = 5.0
_LEAST_SIGMA = 5e-4
_WANDERING = 0.5  # random walk of the remaining slip, per square root of a metre


class Parameters(BaseModel):
    """Size and number of the drives, and range of the search for the hold limit.

    In virtual time several `processes` drive at once; these drives are not recorded.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    length_m: float = Field(0.6, gt=0.1, le=3.0, description="Length of each line, m.")
    speed_m_s: float = Field(0.1, gt=0, le=3.5, description="Speed along a line, m/s.")
    repetitions: int = Field(3, ge=2, le=20, description="How often each line is driven.")
    processes: int = Field(
        1, ge=1, le=8, description="How many drives there are at once; in virtual time only."
    )
    hold: bool = Field(
        True, description="Also find the heading up to which the robot holds; you set a real robot by hand."
    )
    hold_from_deg: float = Field(15.0, ge=0.0, description="Heading at which that search begins, deg.")
    hold_to_deg: float = Field(60.0, le=80.0, description="Heading at which that search ends, deg.")
    hold_step_deg: float = Field(0.5, gt=0.05, le=10.0, description="How finely that heading is found, deg.")

    @model_validator(mode="after")
    def _range(self) -> Parameters:
        if self.hold_to_deg <= self.hold_from_deg:
            raise ValueError("hold_to_deg must be above hold_from_deg")
        return self


def measurements(p: Parameters, config: BenchConfig) -> Iterable[Measurement]:
    """Yield the parameters of a surface, and their required accuracy."""
    for name, what in (("slip", "lines up and down"), ("sag", "lines to the left and right")):
        yield Measurement(
            f"{name}_per_metre",
            "mm/m",
            low=-5.0,
            high=150.0,
            rationale=f"downhill, {what}; on a wall with more the robot cannot work",
        )
        yield Measurement(
            f"{name}_uncertainty",
            "mm/m",
            high=4.0,
            marginal=1.0,
            rationale="half width of the 95 % interval: what slip feed-forward can rely on",
        )
    yield Measurement("turning_per_metre_along", "deg/m", rationale="lines up and down")
    yield Measurement("turning_per_metre_across", "deg/m", rationale="lines to the left and right")
    yield Measurement(
        "direction_difference",
        "mm/m",
        high=80.0,
        rationale="opposite directions differ by geometry, not slip; beyond the limit calibrate first",
    )
    if p.hold:
        for side in ("left", "right"):
            yield Measurement(
                f"hold_angle_{side}",
                "deg",
                low=15.0 + _MARGIN_DEG,
                marginal=2.0,
                rationale=f"largest heading to the {side} at which it stood, 5 deg over the safe range",
            )
        yield Measurement(
            "hold_uncertainty", "deg", high=1.0, rationale="half of the last step of the search"
        )
        if adhesion_limits(config) is not None:
            yield Measurement(
                "friction",
                "1",
                low=0.05,
                high=2.0,
                rationale="of tyres on surface: used of the measured force where the robot began to slide",
            )


def motions(p: Parameters, start: Any) -> dict[str, Trajectory]:
    """Return the four lines from one pose."""
    pose = np.asarray(start, dtype=np.float64)
    return {
        d: line(pose, downhill(pose, p.length_m, d), speed_m_s=p.speed_m_s, name=f"line_{d}")
        for d in DIRECTIONS
    }


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan repetitions with their lines, then the search for the hold limit."""
    _check_wall(config)
    for number in range(1, p.repetitions + 1):
        driven = motions(p, config.environment.start_pose) if number == 1 else {}
        yield PlannedStep(f"repetition {number}", tuple(driven.values()))
    if p.hold:
        yield PlannedStep("hold to the left")
        yield PlannedStep("hold to the right")
    yield PlannedStep("evaluate")


def headline(v: Mapping[str, float]) -> str:
    """Return slip and sag of the robot on this surface."""
    return (
        f"On this surface the robot slips {v['slip_per_metre']:.0f} mm per metre up or down the wall, and "
        f"sags {v['sag_per_metre']:.0f} mm per metre across it."
    )


@procedure(
    name="surface_identification",
    needs=("servos", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"hold": False, "length_m": 0.5, "processes": 2},
)
def run(ctx: Context) -> None:
    """Surface identification: slip and sag per metre, hold angle."""
    p: Parameters = ctx.parameters
    _check_wall(ctx.source.config)
    titles = {k: f"repetition {k}" for k in range(1, p.repetitions + 1)}
    rows: list[Slips] = []
    holds: dict[str, list[float | None]] = {}
    ctx.on_early_end(lambda: evaluate(ctx, rows, {}) if len(rows) >= _FEWEST else None)
    with closing(_driven(ctx, p, [k for k, title in titles.items() if not ctx.finished(title)])) as lines:
        for title in titles.values():
            rows.append(ctx.checkpoint(title, lambda: next(lines)))
    if p.hold:
        search = (p.hold_from_deg, p.hold_to_deg, p.hold_step_deg)
        for side, sense in (("left", 1.0), ("right", -1.0)):
            holds[side] = ctx.checkpoint(f"hold to the {side}", partial(hold_angle, ctx, *search, sense))
    with ctx.step("evaluate"):
        evaluate(ctx, rows, holds)


def _check_wall(config: BenchConfig) -> None:
    if not config.environment.on_wall:
        raise ConfigError(
            f"surface_identification on the bench {config.name!r}, which stands on the floor",
            expected="tilt_rad = 1.5708 in [environment]",
            remedy="choose the bench of the wall",
        )


Slips = dict[str, list[float]]


def _driven(ctx: Context, p: Parameters, numbers: Sequence[int]) -> Generator[Slips, None, None]:
    overrides = {"encoders": None} if _filtered(ctx.source.config) else WITHOUT
    if p.processes > 1 and ctx.source.virtual:
        source = ctx.source.changed(overrides=overrides)
        jobs = [
            DriveJob(source, partial(_alone, p=p, number=k, ways=ways)) for k in numbers for ways in _ALONE
        ]
        with Workers(p.processes) as workers:
            results = ctx.at_once(jobs, workers)
            for _ in numbers:
                found: Slips = {}
                for _ in _ALONE:
                    found |= next(results)
                yield found
        return
    for number in numbers:
        bench = ctx.reopen(f"lines {number}", overrides=overrides)
        reported = partial(ctx.progress, f"repetition {number}")
        yield repetition(bench, p, number, reported)


def _filtered(config: BenchConfig) -> bool:
    """Whether the bench has the sensors for a filter that holds the heading."""
    return all(name in config.devices() for name in _FOR_A_FILTER)


def _alone(bench: Bench, p: Parameters, number: int, ways: tuple[str, ...]) -> Slips:
    return repetition(bench, p, number, lambda done, total: None, ways)


def repetition(
    bench: Bench,
    p: Parameters,
    number: int,
    on_line: Callable[[int, int], object],
    ways: Sequence[str] = DIRECTIONS,
) -> Slips:
    """Drive the lines; return slip per metre (downhill, leftward, turning) by direction.

    Each begins on a newly opened bench, so that it does not depend on the earlier repetitions of a run: a
    resumed run has the same result as an uninterrupted one. The first rest is a little longer in every
    repetition, so that two worlds of one seed do not repeat each other's noise.

    Args:
        bench: bench that was freshly opened.
        p: parameters of the run.
        number: number of the repetition, from 1.
        on_line: called with the number of driven lines, and of all lines.
        ways: directions to drive.
    """
    filtered = _filtered(bench.config)
    feedback, observers = ("ekf", ("odometry",)) if filtered else ("odometry", ())
    enable_hold(bench, 0.5 + STAGGER_S * (number + DIRECTIONS.index(ways[0]) / len(DIRECTIONS)))
    found = {}
    for k, direction in enumerate(ways, start=1):
        pose = enable_hold(bench)
        motion = bench.drive(
            motions(p, pose)[direction], feedback=feedback, observers=observers, hold_s=0.5, start_pose=pose
        )
        rolled = motion.observer("odometry") if filtered else motion.estimate
        found[direction] = list(slip_of(motion, rolled).per_metre())
        on_line(k, len(ways))
    return found


def evaluate(ctx: Context, rows: list[dict[str, list[float]]], holds: dict[str, list[float | None]]) -> None:
    """Set measurements; leave table and figure."""
    every = {d: np.array([row[d] for row in rows]) for d in DIRECTIONS}
    for name, (there, back), turning in (
        ("slip", ("up", "down"), "along"),
        ("sag", ("left", "right"), "across"),
    ):
        found = rate(every[there][:, 0], every[back][:, 0], _SYSTEMATIC)
        ctx.measure(f"{name}_per_metre", 1e3 * found.mean)
        ctx.measure(f"{name}_uncertainty", 1e3 * found.half_width)
        turned = rate(every[there][:, 2], every[back][:, 2], _SYSTEMATIC)
        ctx.measure(f"turning_per_metre_{turning}", math.degrees(turned.mean))
    means = {d: every[d].mean(axis=0) for d in DIRECTIONS}
    ctx.measure(
        "direction_difference",
        1e3 * max(abs(means["up"][0] - means["down"][0]), abs(means["left"][0] - means["right"][0])),
    )
    table = [
        [
            d,
            *(f"{1e3 * v:.2f}" for v in means[d][:2]),
            f"{math.degrees(means[d][2]):.3f}",
            f"{1e3 * every[d][:, 0].std(ddof=1):.2f}",
        ]
        for d in DIRECTIONS
    ]
    head = ["line", "downhill mm/m", "leftward mm/m", "turning deg/m", "spread mm/m"]
    ctx.table(
        "Slip by direction",
        head,
        table,
        f"Motion capture minus wheels, means of {len(rows)} repetitions; spread of the downhill slip.",
    )
    draw(ctx, rows)
    if holds:
        _hold(ctx, holds)
    _leave(ctx, every)


def _leave(ctx: Context, every: dict[str, Array]) -> None:
    """Leave the slip by direction for the estimator, with the spread of a single line."""
    found = next_lines(every, _SYSTEMATIC)
    sigma = np.max([f.sigma for f in found.values()], axis=0)
    along, across = (max(float(s), _LEAST_SIGMA) for s in sigma[:2])
    table: dict[str, Any] = {
        "creep": round(along, 6),
        "creep_across": round(across, 6),
        "creep_per_sqrt_m": round(_WANDERING * along, 6),
        **{f"known_{name}": [round(float(v), 6) for v in f.mean] for name, f in found.items()},
    }
    figures = {}
    for name, line_slip in found.items():
        for k, (axis, unit) in enumerate((("x", "m/m"), ("y", "m/m"), ("turn", "rad/m"))):
            figures[f"{name}_{axis}"] = Figure(
                value=float(line_slip.mean[k]), sigma=float(line_slip.sigma[k]), unit=unit
            )
    values: dict[str, Any] = {f"estimator.wall.{key}": value for key, value in table.items()}
    friction = ctx.findings.values.get("friction", math.nan)
    if math.isfinite(friction):
        values["environment.friction"] = round(friction, 4)
    leave_part(ctx, "slip", values=values, figures=figures, surface=ctx.source.config.environment.surface)
    write_fragment(ctx, {"estimator": {"wall": table}}, "Slip per rolled metre, by direction of travel.")


def _hold(ctx: Context, holds: dict[str, list[float | None]]) -> None:
    widths = []
    for side, (stood, slid, _) in holds.items():
        ctx.measure(f"hold_angle_{side}", math.nan if stood is None else stood)
        widths.append(math.nan if stood is None or slid is None else 0.5 * (slid - stood))
        if slid is None:
            ctx.note(f"To the {side} it still stood at {stood:g} deg, the largest heading that was tried.")
    ctx.measure("hold_uncertainty", max(widths))
    config = ctx.source.config
    limits = adhesion_limits(config)
    if limits is not None:
        used = [
            limits.statics.friction_used(force_n, thrust_wanted_n(config), math.radians(0.5 * (stood + slid)))
            for stood, slid, force_n in holds.values()
            if stood is not None and slid is not None and force_n is not None
        ]
        ctx.measure("friction", float(np.mean(used)) if used else math.nan)
    ctx.table(
        "Hold",
        ["to the", "stood at (deg)", "slid at (deg)"],
        [[side, *("–" if v is None else f"{v:.2f}" for v in ends[:2])] for side, ends in holds.items()],
        "Wheels locked, torque on; standing is less than 2 mm in 1.5 s. Thrust turns with the robot and then "
        "carries less of its weight.",
    )
