"""The paper's odometry calibration on the bench: drive, fit, drive again with what was found, validate.

A round is every motion several times, driven with the parameters found so far. All rounds are fitted
together: each new set of parameters shows directions that the one before could not. Rounds go on while
the latest parameters beat the ones before on recordings that neither was fitted to. A last round that
nothing is fitted to decides whether the result may be used (`docs/procedures.md`).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.calibration.artefact import read_calibration, write_calibration
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.datasets import Recording
from hil.calibration.evaluation import Track, evaluate, position_rmse, track
from hil.calibration.problem import Setting, make_setting
from hil.config.bench import BenchConfig
from hil.geometry import Array
from hil.kinematics import WheelGeometry
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.software import versions
from procedures._calibration_report import draw_rounds, draw_validation, error_table, parameter_table
from procedures._collecting import MOTIONS, MotionName, Repetition, Sizes, collect, read_round, reference

_BOOTSTRAP = 2000
_WORTH = 0.05


class Parameters(BaseModel):
    """How much to drive, how to fit, and when to stop.

    `install` names a calibration.toml that takes the result, as its next version, if validation passes.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    motions: tuple[MotionName, ...] = MOTIONS
    repetitions: int = Field(5, ge=2, le=20)
    validation_repetitions: int = Field(2, ge=1, le=20)
    line_m: float = Field(2.0, gt=0, le=10)
    radius_m: float = Field(0.5, gt=0.1, le=5)
    turns: float = Field(1.0, gt=0, le=3)
    speed_m_s: float = Field(0.11, gt=0)
    min_rounds: int = Field(2, ge=1)
    max_rounds: int = Field(4, ge=1)
    method: Literal["lm", "interior-point", "ga", "pso"] = "lm"
    compared_methods: tuple[Literal["interior-point", "ga", "pso"], ...] = ("interior-point", "ga", "pso")
    processes: int = Field(2, ge=1, le=8)
    install: str = ""

    @property
    def sizes(self) -> Sizes:
        """Of the motions."""
        return Sizes(self.line_m, self.radius_m, self.turns, self.speed_m_s)


def measurements(p: Parameters) -> Iterable[Measurement]:
    """What the validation run must show."""
    yield Measurement("position_rmse_before", "mm", rationale="first round, parameters as the run began")
    yield Measurement(
        "position_rmse_after", "mm", high=4.0, marginal=0.5,
        rationale="odometry against motion capture on motions driven with the result and not fitted",
    )  # fmt: skip
    yield Measurement("heading_rmse_before", "deg")
    yield Measurement("heading_rmse_after", "deg", high=0.5, marginal=0.1, rationale="as above")
    yield Measurement("improvement", "1", low=8.0, marginal=1.0, rationale="position RMSE before over after")
    yield Measurement(
        "later_rounds", "1", high=1.25,
        rationale="worst position RMSE of a later round over the one before: none may undo the work",
    )  # fmt: skip
    yield Measurement(
        "rounds", "1", low=float(p.min_rounds), high=float(p.max_rounds), rationale="own stop rule"
    )
    yield Measurement("rejected_recordings", "1", high=0.1 * p.repetitions * len(p.motions) * p.max_rounds,
                      rationale="recordings that contradict the others")  # fmt: skip


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Rounds as far as they are certain, and the references of one repetition."""
    driven = tuple(reference(m, config.emulation.start_pose, p.sizes) for m in p.motions)
    yield PlannedStep("round 1", driven)
    yield PlannedStep("fit 1")
    for number in range(2, p.min_rounds + 1):
        yield PlannedStep(f"round {number}")
        yield PlannedStep(f"fit {number}")
    yield PlannedStep("validation")
    yield PlannedStep("report")


@procedure(
    name="odometry_calibration", needs=("servos", "mocap"), parameters=Parameters, measurements=measurements,
    plan=plan, bench="emulated_floor",
)  # fmt: skip
def run(ctx: Context) -> None:
    """Odometry calibration: collect, optimise, re-collect with the new parameters, validate."""
    p: Parameters = ctx.parameters
    start = Path(ctx.source.calibration) if ctx.source.calibration else None
    setting = make_setting("recommended", model="exact")
    files: list[Path | None] = [start]
    rounds: list[list[Recording]] = []
    results: list[Calibration] = []
    while len(rounds) < p.max_rounds:
        number = len(rounds) + 1
        rounds.append(_round(ctx, f"round {number}", number, p.repetitions, files[-1]))
        if number > p.min_rounds - 1 and number > 1 and not worth_going_on(ctx, files, rounds[-1], setting):
            break
        with ctx.step(f"fit {number}"):
            results.append(_fit(ctx, rounds, setting, p.method))
            files.append(_keep(ctx.folder / f"calibration_round_{number}.toml", results[-1], ctx))
    fresh = _round(ctx, "validation", len(rounds) + 1, p.validation_repetitions, files[-1])
    with ctx.step("report"):
        chosen = _best(files, fresh, setting)
        _measure(ctx, files, rounds, fresh, chosen, results, setting)
        _show(ctx, files, rounds, fresh, chosen, results, setting)
        _install(ctx, results[chosen - 1])


def _round(
    ctx: Context, label: str, number: int, repetitions: int, calibration: Path | None
) -> list[Recording]:
    p: Parameters = ctx.parameters
    folder = ctx.folder / "recordings" / label.replace(" ", "_")
    first = (number - 1) * p.repetitions
    jobs = [Repetition(folder, p.motions, first + k + 1, p.sizes) for k in range(repetitions)]
    names = ctx.checkpoint(label, lambda: collect(ctx, label, jobs, calibration, p.processes))
    return read_round(folder, names)


def geometry_of(ctx: Context, file: Path | None) -> WheelGeometry:
    """Wheel geometry of a calibration file; the bench's nominal one without."""
    if file is not None:
        return read_calibration(file).geometry
    robot = ctx.source.config.robot
    return WheelGeometry(np.array(robot.wheel_x_m), np.array(robot.wheel_y_m), np.array(robot.wheel_radius_m))


def tracks(recordings: list[Recording], geometry: WheelGeometry, setting: Setting) -> list[Track]:
    """Odometry of recordings under a geometry."""
    return [track(r, geometry, setting.model, setting.signal) for r in recordings]


def rmse_m(recordings: list[Recording], geometry: WheelGeometry, setting: Setting) -> Array:
    """Position RMSE of each recording, m."""
    return np.array([position_rmse(t) for t in tracks(recordings, geometry, setting)])


def worth_going_on(ctx: Context, files: list[Path | None], newest: list[Recording], setting: Setting) -> bool:
    """Whether the latest parameters beat the ones before on recordings that neither was fitted to.

    The improvement counts if the lower end of its 95 % bootstrap interval (over the recordings,
    paired) exceeds 5 %.
    """
    before = rmse_m(newest, geometry_of(ctx, files[-2]), setting)
    after = rmse_m(newest, geometry_of(ctx, files[-1]), setting)
    low = improvement_bound(before, after, np.random.default_rng(ctx.seed))
    ctx.note(
        f"Parameters {len(files) - 1} against {len(files) - 2} on new recordings: position RMSE "
        f"{1e3 * before.mean():.2f} to {1e3 * after.mean():.2f} mm, improvement at least {100 * low:.0f} %."
    )
    return low > _WORTH


def improvement_bound(before: Array, after: Array, rng: np.random.Generator) -> float:
    """Lower end of the one-sided 97.5 % bootstrap interval of 1 - mean(after) / mean(before)."""
    picks = rng.integers(0, len(before), (_BOOTSTRAP, len(before)))
    gains = 1.0 - after[picks].mean(axis=1) / before[picks].mean(axis=1)
    return float(np.percentile(gains, 2.5))


def _fit(ctx: Context, rounds: list[list[Recording]], setting: Setting, method: str) -> Calibration:
    pooled = [r for one in rounds for r in one]
    nominal = geometry_of(ctx, None)
    return calibrate(
        pooled, setting, ctx.clock, method=method, seed=ctx.seed, nominal=nominal, validate=False,
        report=ctx.progress,
    )  # fmt: skip


def _keep(path: Path, result: Calibration, ctx: Context) -> Path:
    path.unlink(missing_ok=True)
    write_calibration(path, result, created=ctx.started, software=versions())
    return path


def _best(files: list[Path | None], fresh: list[Recording], setting: Setting) -> int:
    """Index of the parameter set with the smallest error on the validation run, never the untouched one."""
    found = [rmse_m(fresh, read_calibration(f).geometry, setting).mean() for f in files[1:] if f is not None]
    return 1 + int(np.argmin(found))


def _measure(
    ctx: Context, files: list[Path | None], rounds: list[list[Recording]], fresh: list[Recording], chosen: int,
    results: list[Calibration], setting: Setting,
) -> None:  # fmt: skip
    before = evaluate(tracks(rounds[0], geometry_of(ctx, files[0]), setting))["mean"]
    after = evaluate(tracks(fresh, geometry_of(ctx, files[chosen]), setting))["mean"]
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    for name, scale, key in (
        ("position_rmse", 1e3, "rmse_position_m"), ("heading_rmse", np.degrees(1.0), "rmse_theta_rad"),
    ):  # fmt: skip
        ctx.measure(f"{name}_before", scale * before[key])
        ctx.measure(f"{name}_after", scale * after[key])
    ctx.measure("improvement", before["rmse_position_m"] / after["rmse_position_m"])
    driven = driven_errors(ctx, files, rounds, fresh, setting)
    later = [b / a for a, b in zip(driven, driven[1:], strict=False)]
    ctx.measure("later_rounds", max(later))
    ctx.measure("rounds", len(rounds))
    ctx.measure("rejected_recordings", len(results[-1].fit.rejected))


def driven_errors(
    ctx: Context, files: list[Path | None], rounds: list[list[Recording]], fresh: list[Recording],
    setting: Setting,
) -> list[float]:  # fmt: skip
    """Position RMSE, m, of each round and of the validation run with the parameters that drove it."""
    used = [*files[: len(rounds)], files[-1]]
    return [
        float(rmse_m(recordings, geometry_of(ctx, file), setting).mean())
        for recordings, file in zip([*rounds, fresh], used, strict=True)
    ]


def _show(
    ctx: Context, files: list[Path | None], rounds: list[list[Recording]], fresh: list[Recording], chosen: int,
    results: list[Calibration], setting: Setting,
) -> None:  # fmt: skip
    p: Parameters = ctx.parameters
    columns: dict[str, WheelGeometry] = {"nominal": geometry_of(ctx, None)}
    columns[p.method] = geometry_of(ctx, files[chosen])
    for method in p.compared_methods:
        columns[method] = _fit(ctx, rounds, setting, method).geometry
    parameter_table(ctx, columns)
    first, last = geometry_of(ctx, files[0]), geometry_of(ctx, files[chosen])
    error_table(ctx, "Table II: errors before calibration", evaluate(tracks(rounds[0], first, setting)))
    error_table(ctx, "Table III: errors after calibration", evaluate(tracks(fresh, last, setting)))
    rows: list[list[Any]] = []
    for name, geometry in columns.items():
        table: Any = evaluate(tracks(fresh, geometry, setting))
        rows.append([name, *(f"{1e3 * row['rmse_position_m']:.2f}" for row in table["motions"].values())])
    motions = list(dict.fromkeys(r.motion for r in fresh))
    ctx.table("Validation run, every method: position RMSE (mm)", ["parameters", *motions], rows)
    draw_rounds(ctx, driven_errors(ctx, files, rounds, fresh, setting))
    draw_validation(ctx, tracks(fresh, first, setting), tracks(fresh, last, setting))
    ctx.note(f"Parameter set {chosen} of {len(files) - 1} had the smallest error on the validation run.")
    for line in results[chosen - 1].warnings:
        ctx.note(line[0].upper() + line[1:] + ".")


def _install(ctx: Context, result: Calibration) -> None:
    """The transaction: a file that others use changes only when every limit holds."""
    p: Parameters = ctx.parameters
    ctx.attach("calibration", _keep(ctx.folder / "calibration.toml", result, ctx))
    if not p.install:
        return
    if not ctx.passing():
        ctx.note(f"{p.install} was left as it is: validation did not pass.")
        return
    file = write_calibration(Path(p.install), result, created=ctx.started, software=versions())
    ctx.note(f"{p.install} is now version {file.version}; the version before is kept beside it.")
