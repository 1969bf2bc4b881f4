"""Measures the mount of the tracking camera on the body, its scale, and the true latency of its poses.

The robot turns and drives small distances, observed by motion capture. Camera motion and body motion over
half-second intervals give mount, scale and time offset together (hand-eye calibration). The robot drives
again with the result, which is left as a fragment of `bench.toml`.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.config.bench import BenchConfig
from hil.config.device import TrackerConfig
from hil.config.robot_record import Figure, Spread
from hil.config.robot_record.limits import SCALE_LIMITS
from hil.core.errors import DeviceError
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.record_parts import leave_part
from hil.procedure.sample_arrays import Series
from hil.procedures.tracker_extrinsics.driving import Leg, Trip, drive_trips, legs_of
from hil.procedures.tracker_extrinsics.hand_eye import Extrinsics, Intervals, Truth, intervals, join, solve
from hil.procedures.tracker_extrinsics.report import draw_lateness, draw_path, table
from hil.procedures.tracker_extrinsics.scale import by_whole_legs, session_spread

_DEG = float(np.degrees(1.0))
_HEADING_SHARE = 0.8
_UNUSED: dict[str, object] = {"encoders": None, "imu": None}
_TRIED = 2
"""Number of trips that are driven again with the result: the turns, and one line."""
_KNOWN_LATE_MS = 4.0
"""Uncertainty up to which the camera's latency counts as known."""
_LEAST_SCALE_SIGMA = 1e-5
_SCALE_UNKNOWN = 0.1


class Parameters(BaseModel):
    """Size and number of turns (on a wall: as far as it allows) and drives.

    `session_spread` is the change of the camera's scale from one session to the next (one sigma), if it is
    not in the robot's record: a camera builds a new map each time. In virtual time several `processes` drive
    round trips at once; these are not recorded.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    turn_deg: float = Field(
        90.0,
        ge=5.0,
        le=180.0,
        description="How far the robot turns to either side, deg; on a wall, no further than it holds.",
    )
    way_m: float = Field(0.4, ge=0.1, le=3.0, description="How far the robot drives along X and along Y, m.")
    repetitions: int = Field(2, ge=1, le=20, description="How often turns and drives are repeated.")
    speed_m_s: float = Field(0.1, gt=0, le=3.5, description="Speed of the drives, m/s.")
    session_spread: float = Field(
        0.001,
        gt=0,
        le=0.05,
        description="Share by which the camera's scale differs from session to session, one sigma.",
    )
    processes: int = Field(
        1, ge=1, le=8, description="How many round trips are driven at once; in virtual time only."
    )


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the mount, the latency error, and the improvement by both."""
    for axis in "xy":
        yield Measurement(
            f"mount_{axis}", "mm", low=-400.0, high=400.0, rationale="within the robot's outline"
        )
        yield Measurement(f"mount_{axis}_uncertainty", "mm", high=4.0, rationale="half of the 95 % interval")
    for axis in ("roll", "pitch", "yaw"):
        yield Measurement(
            f"{axis}_correction",
            "deg",
            low=-10.0,
            high=10.0,
            marginal=3.0,
            rationale="beyond, the mount's axes are swapped, not just misaligned",
        )
        yield Measurement(f"{axis}_uncertainty", "deg", high=1.0, rationale="half of the 95 % interval")
    yield Measurement(
        "late",
        "ms",
        low=-40.0,
        high=40.0,
        marginal=10.0,
        rationale="stamps minus truth, at the configured latency",
    )
    yield Measurement(
        "late_uncertainty",
        "ms",
        high=3.0 * _KNOWN_LATE_MS,
        marginal=2.0 * _KNOWN_LATE_MS,
        rationale="half of the 95 % interval; in the upper two thirds the latency stays as configured",
    )
    yield Measurement(
        "scale",
        "1",
        low=SCALE_LIMITS[0],
        high=SCALE_LIMITS[1],
        marginal=0.01,
        rationale="distance by the camera over true distance; 0.5 % is usual, 20 % is reported",
    )
    yield Measurement("scale_uncertainty", "1", rationale="half of the 95 % interval")
    yield Measurement("residual_position", "mm", high=3.0, marginal=0.5, rationale="per half second and axis")
    yield Measurement("residual_angle", "mrad", high=5.0, marginal=1.0, rationale="per half second and axis")
    yield Measurement(
        "outliers", "1", high=0.1, rationale="intervals beyond four sigma: jumps, lost tracking"
    )
    yield Measurement(
        "before.position_rmse", "mm", rationale="camera against motion capture, mount as configured"
    )
    yield Measurement(
        "applied.position_rmse", "mm", high=8.0, marginal=2.0, rationale="the same path with the result"
    )


def tour(p: Parameters, config: BenchConfig) -> tuple[Trip, ...]:
    """Return round trips: turns to both sides, a line along each axis."""
    turn = p.turn_deg / _DEG
    if config.environment.on_wall:
        turn = min(turn, _HEADING_SHARE * config.safety.heading_limit_rad)
    home = (0.0, 0.0, 0.0)
    turns = ((0.0, 0.0, turn), (0.0, 0.0, -turn), home)
    return (turns, ((p.way_m, 0.0, 0.0), home), ((0.0, p.way_m, 0.0), home)) * p.repetitions


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the tour, and its first trips again."""
    start = np.array(config.environment.start_pose)
    trips = tour(p, config)
    yield PlannedStep("tour", tuple(legs_of(trips, start, p.speed_m_s)))
    yield PlannedStep("solve")
    yield PlannedStep("apply", tuple(legs_of(trips[:_TRIED], start, p.speed_m_s)))


def headline(v: Mapping[str, float]) -> str:
    """Return the position of the camera, and its error with this mount and with the configured one."""
    return (
        f"The camera sits {v['mount_x']:.0f} mm ahead of the robot's middle and {v['mount_y']:.0f} mm to the "
        f"left. With this mount its position error is {v['applied.position_rmse']:.1f} mm (RMSE); with the "
        f"mount as configured before it was {v['before.position_rmse']:.1f} mm."
    )


@procedure(
    name="tracker_extrinsics",
    needs=("servos", "tracker", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    bench="emulated_floor",
    quick={"repetitions": 1, "way_m": 0.8, "processes": 2},
)
def run(ctx: Context) -> None:
    """Tracking camera: mount and time offset from motion against motion capture."""
    p: Parameters = ctx.parameters
    trips = tour(p, ctx.source.config)
    with ctx.step("tour"):
        driven = drive_trips(ctx, "", trips, unmeasured(ctx.source.config))
    with ctx.step("solve"):
        found = evaluate(ctx, driven)
    if not ctx.passing():
        ctx.note("The result was neither applied nor written down: see what failed.")
        return
    with ctx.step("apply"):
        apply(ctx, found, trips[:_TRIED])


def unmeasured(config: BenchConfig) -> dict[str, object]:
    """Return overrides for a camera of unknown scale, so that no check stops the robot because of it."""
    if config.estimator.wheel_scale_sigma > 0.0:
        return _UNUSED
    return {**_UNUSED, "estimator.tracker.scale_sigma": _SCALE_UNKNOWN}


def collected(legs: Sequence[Leg]) -> tuple[Series, Series, Intervals]:
    """Return truth and camera of all legs on one time axis, and the camera's intervals within the legs."""
    parts = [intervals(leg.seen) for leg in legs if len(leg.seen) > 2]
    if not parts or not any(len(leg.truth) for leg in legs):
        raise DeviceError("tracker", "no usable poses on the whole tour", remedy="hil run bring_up")
    return _joined([leg.truth for leg in legs]), _joined([leg.seen for leg in legs]), join(parts)


def _joined(parts: list[Series]) -> Series:
    t_s, host_s, device_s, values = (
        np.concatenate([getattr(p, k) for p in parts]) for k in ("t_s", "host_s", "device_s", "values")
    )
    return Series(t_s, host_s, device_s, values, sum(p.seen for p in parts))


def evaluate(ctx: Context, driven: Sequence[Sequence[Leg]]) -> Extrinsics:
    """Solve, set measurements and draw; `driven` holds the legs of each round trip."""
    legs = list(chain.from_iterable(driven))
    config = ctx.source.config.of(TrackerConfig)
    assert config is not None
    truth_series, seen, parts = collected(legs)
    truth = Truth(truth_series)
    whole, parts = len(parts), parts.seen_by(truth)
    if missed := whole - len(parts):
        ctx.note(f"Motion capture did not see {missed} of the camera's {whole} intervals; they do not count.")
    found = solve(parts, truth, config.mount_position_m, config.mount_rotation_wxyz)
    found = by_whole_legs(legs, found)
    for k, axis in enumerate("xy"):
        ctx.measure(f"mount_{axis}", 1e3 * found.position_m[k])
        ctx.measure(f"mount_{axis}_uncertainty", 1e3 * found.position_uncertainty_m[k])
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        ctx.measure(f"{axis}_correction", found.angles_rad[k] * _DEG)
        ctx.measure(f"{axis}_uncertainty", found.angles_uncertainty_rad[k] * _DEG)
    ctx.measure("late", 1e3 * found.late_s)
    ctx.measure("late_uncertainty", 1e3 * found.late_uncertainty_s)
    ctx.measure("scale", found.scale)
    ctx.measure("scale_uncertainty", found.scale_uncertainty)
    ctx.measure("residual_position", 1e3 * found.position_rms_m)
    ctx.measure("residual_angle", 1e3 * found.angle_rms_rad)
    ctx.measure("outliers", found.outliers)
    table(ctx, found)
    draw_path(ctx, truth, seen, found)
    draw_lateness(ctx, parts, truth, found)
    ctx.measure("before.position_rmse", 1e3 * disagreement_m(chain.from_iterable(driven[:_TRIED])))
    return found


def disagreement_m(legs: Iterable[Leg]) -> float:
    """Return the RMS distance of the aligned camera from motion capture, both from the start of each leg.

    Legs whose start is missing in motion capture are left out, and samples in its gaps.
    """
    errors = []
    for leg in legs:
        truth, seen = leg.truth, leg.aligned
        if len(truth) < 2 or len(seen) < 2:
            continue
        known = Truth(truth).sees(seen.t_s)
        if not known[0]:
            continue
        at_s = seen.t_s[known]
        begin_s = np.full(len(at_s), at_s[0])
        path, _ = Truth(truth).steps(begin_s, at_s)
        own, _ = Truth(seen).steps(begin_s, at_s)
        errors.append(np.sum((path - own) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(errors)))) if errors else float("nan")


def apply(ctx: Context, found: Extrinsics, trips: Sequence[Trip]) -> None:
    """Drive some of the tour's trips with the result; leave the result as a fragment.

    Only the configuration changes, not the mount of an emulated camera.
    """
    config = ctx.source.config.of(TrackerConfig)
    assert config is not None
    x, y = found.position_m
    own_sigma = max(0.5 * found.scale_uncertainty, _LEAST_SCALE_SIGMA)
    spread = session_spread(ctx, found.scale)
    values: dict[str, Any] = {
        "mount_position_m": [round(float(v), 5) for v in (x, y, config.mount_position_m[2])],
        "mount_rotation_wxyz": [round(float(v), 6) for v in found.rotation_wxyz],
        "scale": round(found.scale, 5),
        "scale_sigma": float(f"{math.hypot(own_sigma, spread):.2g}"),
        "latency_s": config.latency_s,
    }
    if 1e3 * found.late_uncertainty_s <= _KNOWN_LATE_MS:
        values["latency_s"] = round(max(0.0, config.latency_s + found.late_s), 5)
    else:
        ctx.note(
            f"tracker.latency_s stays {config.latency_s:g}: the camera is too noisy to show its delay, "
            f"{1e3 * found.late_s:+.1f} ± {1e3 * found.late_uncertainty_s:.1f} ms, to {_KNOWN_LATE_MS:g} ms. "
            "Mount and scale are known. A longer way (way_m) or more repetitions show it."
        )
    true = {
        "mount_position_m": config.mount_position_m,
        "mount_rotation_wxyz": config.mount_rotation_wxyz,
        **ctx.source.config.imperfections("tracker"),
    }
    overrides = {**_UNUSED, **{f"tracker.{k}": v for k, v in values.items()}, "emulation.tracker": true}
    driven = drive_trips(ctx, "applied", trips, overrides)
    ctx.measure("applied.position_rmse", 1e3 * disagreement_m(chain.from_iterable(driven)))
    write_fragment(ctx, {"tracker": values}, "Mount, scale and latency of the tracking camera.")
    _leave(ctx, found, values, own_sigma, spread)


def _leave(ctx: Context, found: Extrinsics, values: dict[str, Any], own_sigma: float, spread: float) -> None:
    """Leave the camera's part of the record.

    Args:
        ctx: context of the run.
        found: mount, scale and latency error.
        values: keys of `[tracker]`.
        own_sigma: sigma of the scale in this session.
        spread: sigma of the scale from session to session.
    """
    config = ctx.source.config.of(TrackerConfig)
    assert config is not None
    late_s = config.latency_s + found.late_s
    figures = {
        "scale": Figure(value=found.scale, sigma=own_sigma),
        "scale_from_session_to_session": Figure(value=spread),
        "latency": Figure(value=late_s, sigma=0.5 * found.late_uncertainty_s, unit="s"),
    }
    for k, axis in enumerate("xy"):
        half_m = float(found.position_uncertainty_m[k])
        figures[f"mount_{axis}"] = Figure(value=float(found.position_m[k]), sigma=0.5 * half_m, unit="m")
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        half_rad = float(found.angles_uncertainty_rad[k])
        figures[f"mount_{axis}_correction"] = Figure(
            value=float(found.angles_rad[k]), sigma=0.5 * half_rad, unit="rad"
        )
    names = (
        "mount_x",
        "mount_y",
        "mount_roll_correction",
        "mount_pitch_correction",
        "mount_yaw_correction",
        "scale",
        "latency",
    )
    matrix = tuple(tuple(float(v) for v in row) for row in found.covariance)
    leave_part(
        ctx,
        "camera",
        values={f"tracker.{key}": value for key, value in values.items()},
        figures=figures,
        covariance=Spread(names=names, matrix=matrix),
    )
