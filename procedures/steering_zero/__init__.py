"""Finds the zeros of the four steering axes, from the external encoders and from the body's motion.

All axes are swept together, compared with their encoders, and fitted. Then the robot drives out and back
along two directions: the common zero from this motion must agree with that of the encoders. Last, the robot
drives with the new zeros. They are left as a fragment of `bench.toml`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.bench import Bench
from hil.bench.loop_settings import load_shares
from hil.config.bench import BenchConfig
from hil.config.robot_record import Figure
from hil.config.robot_record.limits import ZERO_LIMIT_RAD
from hil.core.errors import DeviceError
from hil.core.geometry import Array, rotation2
from hil.core.signals import WHEELS
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.record_parts import leave_part
from hil.procedure.sample_arrays import encoders, wheels
from hil.procedure.scripted_joints import Stretch, play
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.steering_zero.fit import AxisFit, Leg, fit_axis, judge_leg, toe_turn_rad_m
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style, thin
from hil.robot.trajectories import Trajectory, line

_DEG = float(np.degrees(1.0))
_WAYS = (("forwards", 0.0), ("back", np.pi), ("left", np.pi / 2.0), ("right", -np.pi / 2.0))
_MARGIN_RAD = 0.05


class Parameters(BaseModel):
    """Size and number of the sweeps and drives."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    sweep_deg: float = Field(
        100.0, ge=45.0, le=115.0, description="How far the wheels are swept to either side, deg."
    )
    sweep_s: float = Field(
        8.0, ge=2.0, le=120, description="How long a sweep from one end to the other takes, s."
    )
    sweeps: int = Field(2, ge=1, le=10, description="How often the wheels are swept to and fro.")
    leg_m: float = Field(0.4, ge=0.1, le=3.0, description="How far the robot drives in each direction, m.")
    legs: int = Field(2, ge=1, le=10, description="How often each direction is driven.")
    speed_m_s: float = Field(0.08, gt=0, le=3.5, description="Speed of the drives, m/s.")


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the measurements of each axis, then those of the motion."""
    for w in WHEELS:
        yield Measurement(
            f"steer_{w}.zero",
            "deg",
            low=-ZERO_LIMIT_RAD * _DEG,
            high=ZERO_LIMIT_RAD * _DEG,
            marginal=1.0,
            rationale="servo angle at which the wheel points ahead; a tooth of the horn is 15 deg",
        )
        yield Measurement(
            f"steer_{w}.zero_uncertainty", "deg", high=0.25, rationale="half of the 95 % interval"
        )
        yield Measurement(
            f"steer_{w}.backlash", "deg", low=-0.05, high=0.6, marginal=0.1, rationale="gears; 0.25 when new"
        )
        yield Measurement(
            f"steer_{w}.eccentricity", "deg", high=1.5, marginal=0.3, rationale="of the magnet, once per turn"
        )
        yield Measurement(
            f"steer_{w}.residual", "deg", high=0.3, marginal=0.05, rationale="noise 0.06 and two resolutions"
        )
    yield Measurement("common.by_encoders", "deg", rationale="load-weighted mean of the axes' offsets")
    yield Measurement("common.by_motion", "deg", rationale="direction of travel minus mean steering")
    yield Measurement("common.by_motion_uncertainty", "deg", high=0.4, rationale="half of the 95 % interval")
    yield Measurement(
        "common.disagreement",
        "deg",
        low=-0.5,
        high=0.5,
        marginal=0.1,
        rationale="motion minus encoders; outside, an encoder's zero or the capture body's heading is wrong",
    )
    yield Measurement(
        "turn_disagreement",
        "deg/m",
        low=-6.0,
        high=6.0,
        marginal=1.0,
        rationale="largest half difference of out and back, without toe; radii unequal by 1 % make 2.5",
    )
    yield Measurement(
        "applied.worst_heading",
        "deg",
        high=0.4,
        marginal=0.1,
        rationale="largest heading of a wheel by its encoder, zeros applied, commanded straight",
    )
    yield Measurement(
        "applied.direction",
        "deg",
        low=-0.4,
        high=0.4,
        marginal=0.1,
        rationale="direction of travel minus steering, zeros applied",
    )


def leg(p: Parameters, start: Array, name: str, alpha_rad: float) -> Trajectory:
    """Return a straight leg along a body direction."""
    pose = np.asarray(start, dtype=np.float64)
    step_m = rotation2(float(pose[2]) + alpha_rad) @ np.array([p.leg_m, 0.0])
    return line(pose, pose + np.append(step_m, 0.0), speed_m_s=p.speed_m_s, name=name)


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan a sweep, the legs, and the legs with the new zeros."""
    start = np.array(config.environment.start_pose)
    driven = tuple(leg(p, start, name, alpha) for name, alpha in _WAYS)
    yield PlannedStep("sweep")
    yield PlannedStep("legs", driven)
    yield PlannedStep("apply", driven[:2])


def headline(v: Mapping[str, float]) -> str:
    """Return the errors of the steering zeros, before and after."""
    worst = max(abs(v[f"steer_{w}.zero"]) for w in WHEELS)
    return (
        f"The steering zeros were up to {worst:.2f} deg off. With the zeros that were found, the wheels "
        f"point ahead within {v['applied.worst_heading']:.2f} deg."
    )


@procedure(
    name="steering_zero",
    needs=("servos", "encoders", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    bench="emulated_floor",
    quick={"sweep_s": 6.0, "sweeps": 1, "leg_m": 0.3, "legs": 1},
)
def run(ctx: Context) -> None:
    """Steering zeros from the external encoders, checked by motion, applied and driven."""
    unused: dict[str, object] = {"tracker": None, "imu": None}
    bench = ctx.reopen(overrides=unused)
    with ctx.step("sweep"):
        fits = sweep(ctx, bench)
        _measure_axes(ctx, fits)
    with ctx.step("legs"):
        compare(ctx, bench, fits)
    if not ctx.passing():
        ctx.note("The zeros were neither applied nor written down: see what failed.")
        return
    with ctx.step("apply"):
        apply(ctx, fits, unused)


def sweep(ctx: Context, bench: Bench) -> list[AxisFit]:
    """Turn all axes to both sides and back; fit each axis."""
    p: Parameters = ctx.parameters
    pose = enable_hold(bench)
    end = np.full(4, p.sweep_deg / _DEG)
    once = [
        Stretch(p.sweep_s / 2, steering_rad=end),
        Stretch(p.sweep_s, steering_rad=-end),
        Stretch(p.sweep_s / 2, steering_rad=0.0 * end),
    ]
    now = wheels(bench.observe(0.1, feedback="odometry")).values[-1, 8:12]
    motion = play(bench, [Stretch(1.0, steering_rad=np.zeros(4)), *once * p.sweeps], pose, now)
    seen, servo = encoders(motion, bench.config), wheels(motion)
    fits = []
    for k, name in enumerate(WHEELS):
        known = np.isfinite(seen[k]) & (seen.t_s > 1.0)
        if known.sum() < 0.5 * len(seen) or not len(seen):
            raise DeviceError(
                "encoders",
                f"axis {name}: {int(known.sum())} of {len(seen)} samples usable",
                remedy="check magnet and wiring; hil run bring_up",
            )
        t = seen.t_s[known]
        fits.append(fit_axis(t, servo.at(t, 8 + k), seen[k][known], 4 * p.sweeps))
    return fits


def _measure_axes(ctx: Context, fits: Sequence[AxisFit]) -> None:
    zeros = _zeros(ctx, fits)
    for name, zero, fit in zip(WHEELS, zeros, fits, strict=True):
        ctx.measure(f"steer_{name}.zero", zero * _DEG)
        ctx.measure(f"steer_{name}.zero_uncertainty", fit.uncertainty_rad * _DEG)
        ctx.measure(f"steer_{name}.backlash", fit.backlash_rad * _DEG)
        ctx.measure(f"steer_{name}.eccentricity", fit.eccentricity_rad * _DEG)
        ctx.measure(f"steer_{name}.residual", fit.residual_rad * _DEG)
    before = ctx.source.config.alignment.steer_zero_rad
    rows = [
        [
            w,
            f"{old * _DEG:+.3f}",
            f"{new * _DEG:+.3f}",
            f"± {f.uncertainty_rad * _DEG:.3f}",
            f"{f.backlash_rad * _DEG:.3f}",
            f"{f.eccentricity_rad * _DEG:.3f}",
        ]
        for w, old, new, f in zip(WHEELS, before, zeros, fits, strict=True)
    ]
    head = ["wheel", "zero before", "zero found", "95 %", "backlash", "eccentricity"]
    ctx.table("Steering zeros by encoder", head, rows, "deg")
    _draw_axes(ctx, fits)


def _zeros(ctx: Context, fits: Sequence[AxisFit]) -> Array:
    """Return the new `alignment.steer_zero_rad`, (4,) rad."""
    alignment = ctx.source.config.alignment
    offset = np.array([f.offset_rad for f in fits])
    zeros = np.array(alignment.steer_zero_rad) - np.array(alignment.steer_sign) * offset
    return np.asarray(zeros, dtype=np.float64)


def _draw_axes(ctx: Context, fits: Sequence[AxisFit]) -> None:
    figure = new_figure(5.2, 3.8)
    for k, (name, fit) in enumerate(zip(WHEELS, fits, strict=True), start=1):
        axes = style(
            figure.add_subplot(2, 2, k),
            "steering (deg)" if k > 2 else "",
            "encoder − servo (deg)" if k % 2 else "",
            name,
        )
        order = np.argsort(fit.steering_rad)
        at, seen = thin(fit.steering_rad * _DEG, fit.difference_rad * _DEG)
        axes.plot(at, seen, ".", color=SERIES[0], ms=2.5, alpha=0.6, label="samples" if k == 1 else None)
        at, fitted = thin(fit.steering_rad[order] * _DEG, fit.fitted_rad[order] * _DEG)
        axes.plot(at, fitted, color=SERIES[1], lw=1.6, label="fit, without backlash" if k == 1 else None)
        axes.axhline(
            fit.offset_rad * _DEG,
            color=PALETTE["reference"],
            lw=1.0,
            ls="--",
            label="offset" if k == 1 else None,
        )
        legend(axes)
    ctx.figure(
        figure,
        "Encoder against servo",
        "The two bands of samples are the backlash, by direction of turning; the bend comes from the magnet.",
    )


def drive_legs(ctx: Context, bench: Bench, directions: Sequence[tuple[str, float]], label: str) -> list[Leg]:
    """Drive legs one after the other and evaluate each."""
    found = []
    for number, (name, alpha) in enumerate(directions, start=1):
        pose = enable_hold(bench)
        motion = bench.drive(
            leg(ctx.parameters, pose, name, alpha), feedback="odometry", hold_s=0.3, start_pose=pose
        )
        found.append(judge_leg(name, motion, bench.config))
        ctx.progress(label, number, len(directions))
    return found


def compare(ctx: Context, bench: Bench, fits: Sequence[AxisFit]) -> None:
    """Check that the direction of travel agrees with the wheel directions by the encoders.

    Legs are evaluated in pairs, out and back: the effect of gravity on a wall is equal and cancels.
    """
    p: Parameters = ctx.parameters
    found = drive_legs(ctx, bench, _WAYS * p.legs, "legs")
    offset = np.array([f.offset_rad for f in fits])
    common = np.array([f.common_rad for f in found]).reshape(-1, 2).mean(axis=1)
    by_motion, by_encoders = float(common.mean()), float(load_shares(bench.config) @ offset)
    half = 2.0 * float(np.hypot(common.std(ddof=1) / np.sqrt(len(common)), np.radians(0.05)))
    alphas = dict(_WAYS)
    toes = np.array([toe_turn_rad_m(bench.config, offset, alphas[f.name]) for f in found])
    turns = np.array([f.turned_rad_m for f in found])
    ctx.measure("common.by_encoders", by_encoders * _DEG)
    ctx.measure("common.by_motion", by_motion * _DEG)
    ctx.measure("common.by_motion_uncertainty", half * _DEG)
    ctx.measure("common.disagreement", (by_motion - by_encoders) * _DEG)
    rest = (turns - toes).reshape(-1, 2) @ np.array([0.5, -0.5]) * _DEG
    ctx.measure("turn_disagreement", rest[np.argmax(np.abs(rest))])
    rows = [
        [
            f.name,
            f"{1e3 * f.way_m:.0f}",
            f"{f.common_rad * _DEG:+.3f}",
            f"{f.turned_rad_m * _DEG:+.3f}",
            f"{toe * _DEG:+.3f}",
        ]
        for f, toe in zip(found, toes, strict=True)
    ]
    head = ["leg", "distance (mm)", "direction (deg)", "turn (deg/m)", "turn by toe (deg/m)"]
    ctx.table(
        "Legs",
        head,
        rows,
        f"Direction of travel minus mean steering; the encoders say {by_encoders * _DEG:+.3f} deg.",
    )


def apply(ctx: Context, fits: Sequence[AxisFit], unused: dict[str, object]) -> None:
    """Drive with the new zeros, and leave them as a fragment."""
    zeros = [round(float(z), 5) for z in _zeros(ctx, fits)]
    values: dict[str, dict[str, Any]] = {"alignment": {"steer_zero_rad": zeros}}
    bench = ctx.reopen("applied", overrides={**unused, "alignment.steer_zero_rad": zeros})
    pose = enable_hold(bench)
    turn = [Stretch(1.0, steering_rad=np.full(4, side * _MARGIN_RAD)) for side in (1.0, -1.0)]
    straight = Stretch(1.0, steering_rad=np.zeros(4))
    now = wheels(bench.observe(0.1, feedback="odometry")).values[-1, 8:12]
    headings = []
    for side in turn:
        motion = play(bench, [side, straight, Stretch(1.0)], pose, now)
        headings.append(encoders(motion, bench.config).between(2.2, 3.1))
        now = np.zeros(4)
    fitted = np.array([f.fitted_rad[np.argmin(np.abs(f.steering_rad))] - f.offset_rad for f in fits])
    heading = np.mean(headings, axis=0) - fitted
    ctx.measure("applied.worst_heading", np.abs(heading).max() * _DEG)
    found = drive_legs(ctx, bench, _WAYS[:2], "applied")
    ctx.measure("applied.direction", float(np.mean([f.common_rad for f in found])) * _DEG)
    write_fragment(ctx, values, "Steering zeros, wheel order FL, BL, BR, FR.")
    _leave(ctx, zeros, fits)
    ctx.note(
        "A calibration.toml that was made with other zeros no longer fits: run odometry_calibration next."
    )


def _leave(ctx: Context, zeros: list[float], fits: Sequence[AxisFit]) -> None:
    """Leave zeros and backlash for the record."""
    axes = list(zip(WHEELS, zeros, fits, strict=True))
    found = {w: Figure(value=z, sigma=0.5 * f.uncertainty_rad, unit="rad") for w, z, f in axes}
    leave_part(ctx, "zeros", values={"alignment.steer_zero_rad": zeros}, figures=found)
    play = {w: Figure(value=abs(f.backlash_rad), unit="rad") for w, _, f in axes}
    leave_part(ctx, "backlash", figures=play)
