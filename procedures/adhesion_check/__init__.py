"""Measures the force that presses the robot on its surface, and whether load cells and fan speed agree.

The fan's force goes up and down in steps while the robot rests, never below the holding force. A line
fitted to the load cells over the squared speed gives the cells' zeros without stopping the fan, and the force
at each speed. The difference of measured and needed force is the margin. On an emulated wall a tethered robot
then shows at which force it slides.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.config.robot_record import Figure
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.record_parts import leave_part
from hil.procedures.adhesion_check.levels import Fit, Level, draw, fit, levels_n, needs_of, rest, visit

_LEVEL_STEP_N, _LEVEL_S, _LEAST = 0.5, 0.3, 0.4
_SLID_M = 0.0005
_TETHERED = {"safety.tethered": True}


class Parameters(BaseModel):
    """Number of force levels, and observation time of each."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    levels: int = Field(
        5, ge=3, le=12, description="How many forces are set, from the least that holds up to the highest."
    )
    dwell_s: float = Field(1.5, ge=0.5, le=20.0, description="How long each force is watched, s.")
    highest_n: float = Field(
        50.0, gt=0.0, le=500.0, description="Highest force that is commanded to the fan, N."
    )
    slide: bool = Field(
        True, description="On an emulated fan, lower the force until the robot slides, to find where it does."
    )


def measurements(p: Parameters, config: BenchConfig) -> Iterable[Measurement]:
    """Yield what must be measured before a robot hangs by its fan."""
    needs = needs_of(config)
    yield Measurement("cells_zero_1", "N", rationale="what the first cell shows without load")
    yield Measurement("cells_zero_2", "N", rationale="what the second one shows")
    yield Measurement(
        "cells_zero_uncertainty", "N", high=2.0, rationale="of their sum, 95 %; a tenth of the margin"
    )
    rated_n = needs.rated_n
    yield Measurement(
        "rated_force",
        "N",
        low=0.8 * rated_n,
        high=1.2 * rated_n,
        marginal=0.02 * rated_n,
        rationale="force at the rated speed, by the cells; beyond 20 % fan, seal or cells have changed",
    )
    yield Measurement(
        "force_residual", "N", high=0.5, rationale="rms of cells against speed: they move together"
    )
    yield Measurement("rated_current", "A", rationale="from the battery at the rated speed")
    if needs.on_wall:
        yield Measurement(
            "hold_margin",
            "N",
            low=needs.reserve * needs.needed_n,
            marginal=1.0,
            rationale=f"measured force over the {needs.needed_n:.1f} N that this surface needs",
        )
        yield Measurement(
            "utilisation",
            "%",
            high=100.0 * config.safety.utilisation_limit,
            marginal=5.0,
            rationale="friction that the most loaded wheel uses at rest",
        )
    if slides(p, config):
        yield Measurement(
            "slides_at", "N", high=1.2 * needs.needed_n, rationale="force at which the tethered robot slid"
        )
        yield Measurement("friction", "1", low=0.05, high=2.0, rationale="of tyres on surface, from it")


def slides(p: Parameters, config: BenchConfig) -> bool:
    """Whether the slide test is run: only with an emulated fan, on a wall."""
    fan = config.devices().get("adhesion")
    return p.slide and config.environment.on_wall and fan is not None and fan.backend == "emulated"


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the force levels, and on an emulated wall the slide."""
    yield PlannedStep("levels of force")
    if slides(p, config):
        yield PlannedStep("slide")
    yield PlannedStep("evaluate")


def headline(v: Mapping[str, float]) -> str:
    """Return the fan's force at rated speed, and its margin over the needed force."""
    return (
        f"At its rated speed the fan presses with {v['rated_force']:.0f} N: {v['hold_margin']:.0f} N more "
        f"than this surface needs."
    )


@procedure(
    name="adhesion_check",
    needs=("servos", "mocap", "adhesion", "load_cells"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"levels": 4, "dwell_s": 0.8, "slide": False},
)
def run(ctx: Context) -> None:
    """Adhesion: zeros of the cells, force against speed, margin, and the force at which the robot slides."""
    p: Parameters = ctx.parameters
    config = ctx.source.config
    rows = ctx.checkpoint("levels of force", lambda: watch_levels(ctx, p))
    levels = [Level(**row) for row in rows]
    ctx.on_early_end(lambda: evaluate(ctx, config, fit(levels), None))
    slid = ctx.checkpoint("slide", lambda: slide(ctx)) if slides(p, config) else None
    with ctx.step("evaluate"):
        evaluate(ctx, config, fit(levels), slid)


def watch_levels(ctx: Context, p: Parameters) -> list[dict[str, Any]]:
    """Measure at every force level, with the robot at rest."""
    bench, found = ctx.bench, []
    wanted = levels_n(bench.config, p.levels, p.highest_n)
    for k, force_n in enumerate(wanted):
        found.append(visit(bench, force_n, p.dwell_s).to_json())
        ctx.progress("levels of force", k + 1, len(wanted))
    back(bench)
    return found


def back(bench: Bench) -> None:
    """Set the working force again."""
    visit(bench, needs_of(bench.config).wanted_n, 0.5)


def slide(ctx: Context) -> dict[str, float]:
    """Lower the fan's force until motion capture sees the tethered robot move; then hold it again."""
    bench = ctx.reopen("slide", overrides=_TETHERED)
    needs, fan = needs_of(bench.config), bench.devices.get("adhesion")
    force_n = 1.3 * needs.needed_n
    visit(bench, force_n, 0.3)
    level = rest(bench, force_n, _LEVEL_S)[0]
    while force_n > _LEAST * needs.needed_n:
        force_n -= _LEVEL_STEP_N
        fan.set_force_n(force_n)
        level, moved_m = rest(bench, force_n, _LEVEL_S)
        if moved_m > _SLID_M:
            break
    fan.brace()
    bench.observe(1.0, feedback="odometry")
    back(bench)
    return {"force_n": level.cells_n, "thrust_n": level.thrust_n}


def evaluate(ctx: Context, config: BenchConfig, found: Fit, slid: dict[str, float] | None) -> None:
    """Set measurements; leave table, figure, and fragment of the bench file."""
    needs = needs_of(config)
    for k in (0, 1):
        ctx.measure(f"cells_zero_{k + 1}", found.zero_n[k])
    ctx.measure("cells_zero_uncertainty", found.zero_uncertainty_n)
    rated_n = found.n_per_rpm2 * needs.rated_rpm**2
    ctx.measure("rated_force", rated_n)
    ctx.measure("force_residual", found.residual_n)
    ctx.measure("rated_current", found.rated_current_a(needs.rated_rpm))
    if needs.on_wall:
        force_n = found.n_per_rpm2 * found.speed_at(needs.wanted_n) ** 2
        ctx.measure("hold_margin", force_n - needs.needed_n)
        used = needs.statics.utilisation(force_n, needs.thrust_n, config.environment.start_pose[2])
        ctx.measure("utilisation", 100.0 * max(used))
    if slid is not None:
        true_n = slid["force_n"] - sum(found.zero_n)
        heading_rad = config.environment.start_pose[2]
        ctx.measure("slides_at", true_n)
        ctx.measure("friction", needs.statics.friction_used(true_n, slid["thrust_n"], heading_rad))
    ctx.table(
        "Levels of force",
        ["commanded (N)", "cells (N)", "speed (1/min)", "battery (A)", "battery (V)"],
        [
            [
                f"{x.asked_n:.1f}",
                f"{x.cells_n:.2f}",
                f"{x.speed_rpm:.0f}",
                f"{x.input_a:.1f}",
                f"{x.input_v:.1f}",
            ]
            for x in found.levels
        ],
        "Means of a rest; the cells with their zeros.",
    )
    draw(ctx, found)
    values: dict[str, dict[str, Any]] = {
        "adhesion": {"rated_force_n": round(rated_n, 2), "rated_rpm": needs.rated_rpm},
        "load_cells": {"zero_n": [round(z, 3) for z in found.zero_n]},
    }
    write_fragment(ctx, values, "Zeros of the load cells, and the force that belongs to a speed of the fan")
    flat = {f"{table}.{key}": value for table, keys in values.items() for key, value in keys.items()}
    half_n = found.zero_uncertainty_n
    figures = {
        "cells_zero": Figure(value=sum(found.zero_n), sigma=0.5 * half_n, unit="N"),
        "rated_force": Figure(value=rated_n, unit="N"),
    }
    if slid is not None:
        figures["friction"] = Figure(value=ctx.findings.values["friction"])
    leave_part(ctx, "hold", values=flat, figures=figures)
