"""The paper's odometry calibration on the bench: drive, fit, drive again with the result, validate.

A round drives every motion several times with the current parameters; the following fit uses all rounds.
Rounds are added while held-out recordings predict an improvement of the fit. A last round, which is not used
for a fit and is driven with the best parameters, decides whether the result may be used.
`docs/procedures.md` describes how to run the procedure and read its report.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.bench.loop_settings import geometry_of, motion_limits
from hil.calibration.calibrate import Calibration
from hil.calibration.calibration_file import calibration_file, save_calibration
from hil.calibration.cross_validation import score
from hil.calibration.evaluation import evaluate
from hil.calibration.problem import PARAMETER_NAMES, make_setting
from hil.calibration.usability_check import made_for
from hil.calibration.versions import store_version
from hil.config.bench import BenchConfig
from hil.config.robot_record import Figure
from hil.config.robot_record.overlay import identity
from hil.core.errors import ConfigError
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.odometry_motions import MOTIONS, MotionName, Repetition, Sizes, followed
from hil.procedure.record_parts import leave_part
from hil.procedure.worker_processes import Workers
from hil.procedures.odometry_calibration.collecting import Collected, collect, read_round
from hil.procedures.odometry_calibration.report import show
from hil.procedures.odometry_calibration.rounds import (
    MOST_PLAY_RAD,
    Driven,
    chosen,
    foresee,
    improve,
    known_play_rad,
    odometry_in,
    rise_beyond_chance,
    tell_gain,
    worth_another,
)
from hil.support.versions import versions

_SIMILAR_MM = 0.5


class Parameters(BaseModel):
    """Amount of driving, method of the fit, and stop rule.

    `model` is how contradicting wheels are combined; by evidence, held-out repetitions select it, the loads
    and the tyre ratio. `steering_play_rad` is the backlash of a steering gear to each side, which is included
    in standard errors; by default it is that of the robot's record, else an eighth of a degree. `install`
    names a calibration.toml that receives the result, as its next version, if validation passes.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    motions: tuple[MotionName, ...] = Field(MOTIONS, description="Motions of a repetition.")
    repetitions: int = Field(5, ge=2, le=20, description="How often each motion is driven in a round.")
    validation_repetitions: int = Field(
        2, ge=1, le=20, description="How often each motion is driven anew to check the result."
    )
    line_m: float = Field(2.5, gt=0, le=10, description="Length of the lines, m.")
    radius_m: float = Field(0.5, gt=0.1, le=5, description="Radius of the circles, m.")
    turns: float = Field(
        1.0, gt=0, le=3, description="How many turns a circle, and a rotation on the spot, has."
    )
    speed_m_s: float = Field(0.118, gt=0, le=3.5, description="Peak speed of the wheels, m/s.")
    model: Literal["by evidence", "creep", "dry-friction", "exact"] = Field(
        "by evidence",
        description="How contradicting wheels are read; by evidence, held-out repetitions choose.",
    )
    steering_play_rad: float | None = Field(
        None,
        ge=0,
        le=MOST_PLAY_RAD,
        description="Backlash of a steering gear to each side, rad; left out, that of the record.",
    )
    min_rounds: int = Field(2, ge=1, description="Rounds that are driven at least.")
    max_rounds: int = Field(4, ge=1, description="Rounds that are driven at most.")
    method: Literal["lm", "interior-point", "ga", "pso"] = Field(
        "lm", description="Solver that finds the parameters."
    )
    compared_methods: tuple[Literal["interior-point", "ga", "pso"], ...] = Field(
        ("interior-point", "ga", "pso"), description="Further solvers whose results are shown beside it."
    )
    processes: int = Field(
        2, ge=1, le=8, description="How many repetitions are driven at once; in virtual time only."
    )
    install: str = Field(
        "", description="A calibration.toml that takes the result as its next version if validation passes."
    )

    @model_validator(mode="after")
    def _rounds(self) -> Parameters:
        if self.min_rounds > self.max_rounds:
            raise ValueError(f"min_rounds = {self.min_rounds} exceeds max_rounds = {self.max_rounds}")
        return self

    @property
    def sizes(self) -> Sizes:
        """Sizes of the motions, m and rad."""
        return Sizes(self.line_m, self.radius_m, self.turns, self.speed_m_s)


def measurements(p: Parameters) -> Iterable[Measurement]:
    """Yield the requirements on the validation run."""
    yield Measurement("position_rmse_before", "mm", rationale="first round, parameters as the run began")
    yield Measurement(
        "position_rmse_after",
        "mm",
        high=4.0,
        marginal=0.5,
        rationale="odometry against motion capture on motions driven with the result and not fitted",
    )
    yield Measurement("heading_rmse_before", "deg")
    yield Measurement("heading_rmse_after", "deg", high=0.5, marginal=0.1, rationale="as above")
    yield Measurement("improvement", "1", rationale="position RMSE before over after")
    yield Measurement(
        "worst_later_round",
        "mm",
        high=_SIMILAR_MM,
        rationale="largest rise of the position RMSE from a round to a later one, beyond chance",
    )
    yield Measurement(
        "rounds", "1", low=float(p.min_rounds), high=float(p.max_rounds), rationale="by its own stop rule"
    )
    yield Measurement("rejected_recordings", "1")
    yield Measurement(
        "rejected_share",
        "1",
        high=0.1,
        rationale="of the recordings of all rounds in the fit that was kept, those that "
        "contradict the others",
    )


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the certain rounds, with the references of one repetition."""
    _check_turns(p, config)
    start, geometry = config.environment.start_pose, geometry_of(config)
    driven = tuple(followed(m, start, p.sizes, geometry, config) for m in p.motions)
    for number in range(1, p.min_rounds + 1):
        yield PlannedStep(f"round {number}", driven if number == 1 else ())
        if number < p.min_rounds:
            yield PlannedStep(f"fit {number}")
    yield PlannedStep("validation")
    yield PlannedStep("report")


def headline(v: Mapping[str, float]) -> str:
    """Return the error of odometry on motions that were not fitted, with the calibration and before."""
    return (
        f"The position error of odometry is {v['position_rmse_after']:.1f} mm (RMSE, driven anew with what "
        f"was found); before it was {v['position_rmse_before']:.1f} mm."
    )


@procedure(
    name="odometry_calibration",
    needs=("servos", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    bench="emulated_floor",
    quick={
        "motions": ("line_x", "line_y", "circle_ccw", "rotation_cw"),
        "repetitions": 2,
        "validation_repetitions": 1,
        "line_m": 1.0,
        "radius_m": 0.4,
        "turns": 0.5,
        "max_rounds": 2,
        "compared_methods": (),
    },
)
def run(ctx: Context) -> None:
    """Odometry calibration: collect, optimise, re-collect with the new parameters, validate."""
    p: Parameters = ctx.parameters
    _check_turns(p, ctx.source.config)
    with Workers(p.processes) as workers:
        rounds, results, best = _rounds(ctx, workers)
        file = _round_file(ctx, best) if best else ctx.source.calibration
        fresh = _drive(ctx, "validation", len(rounds) + 1, p.validation_repetitions, file, workers)
    with ctx.step("report"):
        _measure(ctx, rounds, fresh)
        ctx.note(
            f"Round {best + 1} was driven best; its parameters are the result."
            if best < len(rounds)
            else f"The result is the fit after round {best}: its held-out error is below that of any round."
        )
        if best == 0:
            ctx.measure("rejected_recordings", 0)
            ctx.measure("rejected_share", 0)
            ctx.note("No fit was better than the parameters that the run began with; nothing to install.")
            return
        result = results[best - 1]
        rejected, fitted = len(result.rejected), len(result.recordings)
        ctx.measure("rejected_recordings", rejected)
        ctx.measure("rejected_share", rejected / (rejected + fitted))
        if not ctx.passing() and (others := _other_models(result)):
            ctx.note(
                f"On this surface no forward model is clearly right; {result.setting.model} was taken. Run "
                f"it again with another one: {' or '.join(f'--set model={name}' for name in others)}."
            )
        show(ctx, rounds, fresh, result, p.method, p.compared_methods)
        judged = score(fresh.recordings, fresh.odometry.geometry, result.setting)
        _install(ctx, replace(result, validation={"fresh_run": judged}))


def _other_models(result: Calibration) -> list[str]:
    """Return forward models that may be as good as the selected one."""
    rivals = () if result.choice is None else result.choice.rivals
    return sorted({rival.setting.model for rival in rivals} - {result.setting.model})


def _check_turns(p: Parameters, config: BenchConfig) -> None:
    """Reject motions that turn further than a wall allows from any start heading."""
    limit_rad = motion_limits(config).heading_limit_rad
    turning = [name for name in p.motions if not name.startswith("line")]
    if limit_rad is not None and turning and math.pi * p.turns > limit_rad:
        raise ConfigError(
            f"odometry_calibration on the bench {config.name!r}, which is on a wall: "
            f"{', '.join(turning)} turn the robot by {360.0 * p.turns:.3g} deg",
            expected=f"headings of at most {math.degrees(limit_rad):.3g} deg to either side",
            remedy="choose the bench of the floor",
        )


def _rounds(ctx: Context, workers: Workers) -> tuple[list[Driven], list[Calibration], int]:
    """Drive and fit rounds; return them, the fits, and the round after which the best was fitted.

    The best parameters are those with the least error while driving; or the newest fit, not yet driven with,
    if its held-out error on the newest round is smaller.
    """
    p: Parameters = ctx.parameters
    play_rad = p.steering_play_rad if p.steering_play_rad is not None else known_play_rad(ctx)
    setting = replace(make_setting("recommended", model="creep"), by_motion=True, steering_play_rad=play_rad)
    rounds: list[Driven] = []
    results: list[Calibration] = []
    file, best = ctx.source.calibration, 0
    while True:
        number = len(rounds) + 1
        rounds.append(_drive(ctx, f"round {number}", number, p.repetitions, file, workers))
        if number > 1:
            tell_gain(ctx, rounds[best], rounds[-1])
        if rounds[-1].rmse_m().mean() < rounds[best].rmse_m().mean():
            best = number - 1
        if number == p.max_rounds:
            return rounds, results, best
        with ctx.step(f"fit {number}"):
            driven = [r for d in rounds for r in d.recordings]
            results.append(improve(ctx, driven, chosen(ctx, rounds, setting, p.model), p.method))
            file = _keep(ctx, _round_file(ctx, number), results[-1])
            if number == 1 or number < p.min_rounds:
                continue
            foreseen = foresee(rounds, results[-1])
            if not worth_another(ctx, number, foreseen):
                better = foreseen.without_repetition.mean() < rounds[best].rmse_m().mean()
                return rounds, results, number if better else best


def _round_file(ctx: Context, number: int) -> Path:
    """Return the path of the fit's result after a round."""
    return ctx.folder / f"calibration_round_{number}.toml"


def _drive(
    ctx: Context, label: str, number: int, repetitions: int, calibration: Path | None, workers: Workers
) -> Driven:
    p: Parameters = ctx.parameters
    folder = ctx.folder / "recordings" / label.replace(" ", "_")
    first = (number - 1) * p.repetitions
    jobs = [Repetition(folder, p.motions, first + k + 1, p.sizes) for k in range(repetitions)]
    names = collect(ctx, label, jobs, calibration, workers, _so_far(p, label, number))
    return Driven(label, read_round(folder, names), odometry_in(calibration, ctx.source.config))


def _so_far(p: Parameters, label: str, number: int) -> Collected:
    """Return the progress of this round; beyond `min_rounds` the expected total grows by a round."""
    span = f"{p.min_rounds}" if p.min_rounds == p.max_rounds else f"{p.min_rounds} to {p.max_rounds}"
    validating = label == "validation"
    rounds = number - 1 if validating else max(p.min_rounds, number)
    per_round = len(p.motions) * p.repetitions
    return Collected(
        label if validating else f"{label} of {span}",
        before=(number - 1) * per_round,
        expected=rounds * per_round + len(p.motions) * p.validation_repetitions,
    )


def _keep(ctx: Context, path: Path, result: Calibration) -> Path:
    file = calibration_file(
        result, created=ctx.started, software=versions(), made_for=made_for(ctx.source.config)
    )
    save_calibration(path, file)
    return path


def _measure(ctx: Context, rounds: list[Driven], fresh: Driven) -> None:
    before: Any = evaluate(rounds[0].tracks())["mean"]
    after: Any = evaluate(fresh.tracks())["mean"]
    for name, scale, key in (
        ("position_rmse", 1e3, "rmse_position_m"),
        ("heading_rmse", np.degrees(1.0), "rmse_theta_rad"),
    ):
        ctx.measure(f"{name}_before", scale * before[key])
        ctx.measure(f"{name}_after", scale * after[key])
    ctx.measure("improvement", before["rmse_position_m"] / after["rmse_position_m"])
    driven, rng = [d.rmse_m() for d in rounds], np.random.default_rng(ctx.seed)
    rises = [rise_beyond_chance(driven[i], driven[j], rng) for j in range(len(driven)) for i in range(j)]
    ctx.measure("worst_later_round", 1e3 * max(rises, default=0.0))
    ctx.measure("rounds", len(rounds))


def _leave(ctx: Context, result: Calibration, path: Path) -> None:
    """Leave the calibration as a part of the record."""
    geometry, std = result.geometry.vector(), result.intervals.std
    figures = {
        name: Figure(
            value=float(v), sigma=float(s) if math.isfinite(s) else None, unit="rad" if k > 11 else "m"
        )
        for k, (name, v, s) in enumerate(zip(PARAMETER_NAMES, geometry, std, strict=False))
    }
    fresh = result.validation["fresh_run"]["mean"]
    figures["validation_position_rmse"] = Figure(value=fresh["rmse_position_m"], unit="m")
    figures["validation_heading_rmse"] = Figure(value=fresh["rmse_theta_rad"], unit="rad")
    leave_part(ctx, "geometry", figures=figures, files={"calibration": path})


def _install(ctx: Context, result: Calibration) -> None:
    """Install the result in the calibration file only if every limit holds."""
    p: Parameters = ctx.parameters
    verdict, config = ctx.verdict().value, ctx.source.config
    robot = identity(config, ctx.source.seed)
    file = calibration_file(
        result,
        created=ctx.started,
        software=versions(),
        verdict=verdict,
        made_for=made_for(config),
        robot=robot,
    )
    path = ctx.folder / "calibration.toml"
    save_calibration(path, file)
    ctx.attach("calibration", path)
    _leave(ctx, result, path)
    if not p.install:
        return
    target = Path(p.install)
    kept = store_version(
        target, result, created=ctx.started, software=versions(), verdict=verdict, config=config, robot=robot
    )
    ctx.note(
        f"{target} is now version {kept.file.version}; `hil calibration rollback {target}` takes it back."
        if kept.in_place
        else f"{target} was left as it is: validation did not pass. The result is kept as {kept.path}."
    )
