"""Measures noise of the robot's sensors, at rest and in motion, and their drift, for its filter.

The robot rests, then drives there and back along both axes and turns a little, observed by motion capture.
Noise and drift of each sensor come from its samples; vibration of the robot comes from the remaining filter
innovations. The result goes into the robot's record, and is used unless the bench file sets other values. Of
an emulated device only its samples are used.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.core.errors import DeviceError
from hil.core.geometry import Array
from hil.core.signals import Measurements
from hil.estimator.noise_matching import DrivenRun, match
from hil.estimator.noise_parameters import MEASURED
from hil.estimator.sample_statistics import DEAD_ZONE, has_dead_zone
from hil.estimator.sensor_noise import SensorNoise, measure
from hil.estimator.tuning import with_values
from hil.loop.driven_motion import Motion
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.record_parts import leave_part
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.sensor_noise.report import figures, leave_measurements, table, values_of
from hil.robot.trajectories import Trajectory, line
from hil.support.file_reading import put_dotted

_FOR_A_FILTER = ("imu", "tracker")
_HOLD_S = 0.6
_TURN_SPEED_M_S = 0.03


class Parameters(BaseModel):
    """Duration of the rest, and size of the drives."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    rest_s: float = Field(5.0, ge=2.0, le=3600, description="How long the robot rests at first, s.")
    way_m: float = Field(0.4, ge=0.2, le=3.0, description="How far the robot drives along X and along Y, m.")
    turn_deg: float = Field(6.0, ge=1.0, le=90.0, description="How far it turns at each corner, deg.")
    speed_m_s: float = Field(0.09, gt=0.01, le=3.5, description="Speed of the drives, m/s.")
    repetitions: int = Field(1, ge=1, le=20, description="How often the way is driven.")


def measurements(p: Parameters, config: BenchConfig) -> Iterator[Measurement]:
    """Yield noise and drift by sensor, and the consistency (NIS) of the filter with them."""
    devices = config.devices()
    for one in MEASURED:
        if one.device in devices:
            yield Measurement(one.label, one.unit, rationale=one.meaning)
            yield Measurement(f"{one.label}_uncertainty", one.unit, rationale="half of the 95 % interval")
    for sensor, device in (("wheels", "servos"), ("gyro", "imu"), ("tracker", "tracker")):
        if device in devices:
            yield Measurement(
                f"nis.{sensor}",
                "1",
                low=None if sensor == "gyro" else 0.5,  # one with a dead zone is 0 most of the time
                high=2.0,
                marginal=0.2,
                rationale="median NIS with what was found: 1 where the filter is as sure as it may be",
            )


def tour(p: Parameters, start: Array) -> list[Trajectory]:
    """Return the legs from the pose `start`: up, left, a turn, and back, `repetitions` times."""
    turn = np.radians(p.turn_deg)
    stops = [(0, 0, 0), (p.way_m, 0, 0), (p.way_m, p.way_m, 0), (p.way_m, p.way_m, turn)]
    stops += [(0, p.way_m, turn), (0, 0, turn), (0, 0, 0)]
    poses = np.asarray(start, dtype=np.float64) + np.array(stops, dtype=np.float64)
    legs = [
        line(a, b, speed_m_s=p.speed_m_s if a[2] == b[2] else _TURN_SPEED_M_S, name=f"leg {k}")
        for k, (a, b) in enumerate(pairwise(poses), start=1)
    ]
    return legs * p.repetitions


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan a rest, the way there and back, and the evaluation."""
    yield PlannedStep("rest")
    yield PlannedStep("drives", tuple(tour(p, np.array(config.environment.start_pose))))
    yield PlannedStep("evaluate")


def headline(v: Mapping[str, float]) -> str:
    """Return the noise of the sensors in motion, and the NIS of a filter that uses it."""
    parts = [
        f"{what} {v[name]:.2g} {unit}"
        for name, what, unit in (
            ("wheel_step_moving", "a wheel's step", "um"),
            ("gyro_moving", "the gyro", "mrad/s"),
            ("camera_position_moving", "the camera", "mm"),
        )
        if name in v
    ]
    nis = [value for name, value in v.items() if name.startswith("nis.")]
    sure = f" Median NIS with these: {min(nis):.2f} to {max(nis):.2f}, 1 is ideal." if nis else ""
    return f"Noise in motion, one sigma: {', '.join(parts)}.{sure}"


@procedure(
    name="sensor_noise",
    needs=("servos", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"rest_s": 3.0},
)
def run(ctx: Context) -> None:
    """Noise and drift of every sensor, at rest and in motion, and how the robot shakes."""
    p: Parameters = ctx.parameters
    config = ctx.source.config
    filtered = all(name in config.devices() for name in _FOR_A_FILTER)
    bench = ctx.reopen(overrides={"encoders": None})
    with ctx.step("rest", timeout_s=p.rest_s + 60.0):
        enable_hold(bench)
        rested = bench.observe(p.rest_s, feedback="odometry")
    with ctx.step("drives"):
        driven = list(drives(ctx, bench, p, "ekf" if filtered else "odometry"))
    with ctx.step("evaluate"):
        evaluate(ctx, bench, cycles(rested), driven)


def cycles(motion: Motion) -> tuple[Measurements, ...]:
    """Return the measurements that a filter receives in a motion."""
    return tuple(r.measurements for r in motion.records)


def drives(ctx: Context, bench: Bench, p: Parameters, feedback: str) -> Iterator[DrivenRun]:
    """Drive the tour leg by leg, each from the rest pose by motion capture."""
    legs = tour(p, enable_hold(bench))
    for number, leg in enumerate(legs, start=1):
        pose = enable_hold(bench)
        way = leg.sample(leg.duration_s).pose_in_wall - leg.sample(0.0).pose_in_wall
        along = line(pose, pose + way, duration_s=leg.duration_s, name=leg.name)
        motion = bench.drive(along, feedback=feedback, hold_s=_HOLD_S, start_pose=pose)
        start = replace(bench.start_state(pose), t_ns=motion.records[0].inputs.t_ns)
        yield DrivenRun(cycles(motion), start)
        ctx.progress("drives", number, len(legs))


def evaluate(ctx: Context, bench: Bench, rested: Sequence[Measurements], driven: Sequence[DrivenRun]) -> None:
    """Set measurements; leave the table, and the part of the record."""
    found = measure([rested, *(run.measurements for run in driven)], bench.geometry)
    _must_have_moved(found)
    rates = np.array([s.yaw_rate_rad_s for m in rested for s in m.gyro])
    if has_dead_zone(rates):
        missed = found.gyro.both.sigma()[0]
        ctx.note(
            f"The gyro: {DEAD_ZONE}. estimator.gyro.rate_rad_s = {missed:.3g} is what it misses of the turns "
            "in motion; by it the filter relies on wheels and camera."
        )
    devices = ctx.source.config.devices()
    values = values_of(found, devices)
    surface = bench.config.environment.kind
    config = with_values(bench.config.estimator, values)
    matched = match(config, driven, bench.geometry, surface, ctx.progress)
    values |= matched.values
    leave_measurements(ctx, found, matched.nis, devices)
    table(ctx, found, devices)
    keys = {f"estimator.{name}": float(f"{value:.4g}") for name, value in values.items()}
    leave_part(ctx, "noise", values=keys, figures=figures(found, devices))
    tree: dict[str, Any] = {}
    for key, value in keys.items():
        put_dotted(tree, key, value, "sensor_noise:")
    write_fragment(ctx, tree, "Noise of the sensors, and how the robot shakes.")


def _must_have_moved(found: SensorNoise) -> None:
    if found.wheel_step.moving.freedom < 1.0:
        raise DeviceError(
            "servos",
            "the wheels show no motion at constant speed on the whole way",
            expected="a drive that the wheels' encoders follow",
            remedy="hil run bring_up",
        )
