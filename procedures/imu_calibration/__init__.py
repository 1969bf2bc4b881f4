"""Calibrates the BNO055 on the robot: stores and restores its offsets, measures noise and gravity heading.

The chip learns its gyro offsets at rest. They are read out, stored in a file, and written back after a
restart of the chip; new measurements then check the result. Noise and bias stability come from the Allan
deviation of the turn rate at rest. On a wall, gravity lies in the plane of motion and gives the heading;
its offset from motion capture is corrected in the mount's rotation.
"""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.special import stdtrit

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.config.imu import Bno055Config
from hil.config.robot_record import Figure
from hil.core.errors import ConfigError, DeviceError
from hil.core.geometry import Array, quat_from_yaw, quat_multiply, wrap_array
from hil.estimator.sample_statistics import DEAD_ZONE, has_dead_zone
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.record_parts import leave_part
from hil.procedure.sample_arrays import inertial, integrated, poses
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.imu_calibration.noise import BIAS_FACTOR, FEWEST, allan, evenly
from hil.procedures.imu_calibration.report import draw_allan, draw_headings
from hil.robot.trajectories import Trajectory, line

_DEG = float(np.degrees(1.0))
_GRAVITY_LSB_M_S2, _STANDARD_GRAVITY = 0.01, 9.80665
_GYRO_LSB_DEG_S = 1.0 / 16.0
_LEARNT = 3
_NOISE_LIMIT = 0.03


class Parameters(BaseModel):
    """Duration of the rests, and size of the turns on the wall."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    rest_s: float = Field(
        120.0,
        ge=5.0,
        le=7200,
        description="How long the robot rests while the noise of the gyro is measured, s.",
    )
    learn_s: float = Field(
        20.0, ge=1.0, le=600, description="How long the chip may learn its own offsets at rest, s."
    )
    heading_deg: float = Field(
        10.0, gt=1.0, le=60.0, description="On a wall, how far the robot turns to either side, deg."
    )
    headings: int = Field(5, ge=4, le=21, description="On a wall, at how many headings the robot stands.")
    dwell_s: float = Field(3.0, ge=0.5, le=60, description="How long the robot stands at each heading, s.")
    turn_speed_m_s: float = Field(
        0.03, gt=0, le=3.5, description="Speed of the wheels while the robot turns, m/s."
    )


class StoresOffsets(Protocol):
    """Required interface of the IMU beside its samples: `hil.drivers.imu.bno055.driver.Bno055Imu`."""

    def read_calibration(self) -> Any:
        """Return the offsets that the chip has learnt, an object with `save(path)`."""


def measurements(p: Parameters) -> Iterable[Measurement]:
    """Return the measurements; limits are from the data sheet if it has any (BST-BNO055-DS000, table 0-2)."""
    yield Measurement(
        "gyro_level", "1", low=3.0, rationale="the chip's own judgement of its gyro's calibration, 0 to 3"
    )
    for axis in "xyz":
        yield Measurement(
            f"gyro_offset_{axis}",
            "deg/s",
            low=-3.0,
            high=3.0,
            marginal=0.5,
            rationale="stored; zero-rate offset within 3 deg/s, else the chip is damaged or was moved",
        )
    yield Measurement(
        "gyro_bias",
        "deg/s",
        low=-0.1,
        high=0.1,
        marginal=0.02,
        rationale="mean turn rate about the wall normal at rest, after learning",
    )
    yield Measurement(
        "gyro_noise",
        "deg/s/√Hz",
        low=0.0,
        high=_NOISE_LIMIT,
        marginal=0.002,
        rationale="data sheet 0.014 typical; none means a dead zone, and that it is not known",
    )
    yield Measurement("gyro_noise_uncertainty", "deg/s/√Hz", rationale="half of the 95 % interval")
    yield Measurement(
        "gyro_bias_instability",
        "deg/h",
        high=round(60.0 + white_floor_deg_h(p.rest_s), 1),
        marginal=10.0,
        rationale="lowest point of the Allan deviation: 60, plus what noise adds after so short a rest",
    )
    yield Measurement("accelerometer_noise", "mg/√Hz", high=0.6, marginal=0.1, rationale="0.15 typical")
    yield Measurement(
        "gyro_response",
        "1",
        low=0.8,
        high=1.2,
        marginal=0.05,
        rationale="turns by the gyro over those by motion capture: a gyro that does not measure shows none",
    )
    yield Measurement(
        "heading_offset",
        "deg",
        low=-5.0,
        high=5.0,
        marginal=1.0,
        rationale="gravity minus motion capture at the mean heading; 80 mg of offset make 4.6 deg",
    )
    yield Measurement("heading_offset_uncertainty", "deg", high=0.2, rationale="half of the 95 % interval")
    yield Measurement(
        "heading_scatter", "deg", high=0.15, marginal=0.03, rationale="about the fitted line, one dwell each"
    )
    yield Measurement(
        "restored_difference", "1", high=1.0, rationale="counts, largest of the stored and read back offsets"
    )
    yield Measurement("restored_bias", "deg/s", low=-0.1, high=0.1, marginal=0.02, rationale="as gyro_bias")
    yield Measurement(
        "corrected_heading",
        "deg",
        low=-0.3,
        high=0.3,
        marginal=0.05,
        rationale="gravity minus motion capture with the corrected mount, after a restart of the chip",
    )


def white_floor_deg_h(rest_s: float) -> float:
    """Return the apparent bias instability of a chip at the noise limit, at the longest averaging time."""
    return 3600.0 * _NOISE_LIMIT / BIAS_FACTOR / math.sqrt(rest_s / FEWEST)


def headings(p: Parameters) -> Array:
    """Return the headings to visit, relative to the start, rad."""
    return np.radians(np.linspace(-p.heading_deg, p.heading_deg, p.headings))


def turns(p: Parameters, start: Array) -> list[Trajectory]:
    """Return the turns from the start through all headings and back."""
    stops = np.array([0.0, *headings(p), 0.0])
    poses_in_wall = np.asarray(start, dtype=np.float64) + stops[:, None] * np.array([0.0, 0.0, 1.0])
    return [
        line(a, b, speed_m_s=p.turn_speed_m_s, name=f"heading {b[2] * _DEG:+.0f}")
        for a, b in pairwise(poses_in_wall)
    ]


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan the rests and small turns."""
    yield PlannedStep("learn")
    yield PlannedStep("store")
    yield PlannedStep("rest")
    yield PlannedStep("headings", tuple(turns(p, np.array(config.environment.start_pose))))
    yield PlannedStep("restore")


def headline(v: Mapping[str, float]) -> str:
    """Return the remaining gyro offset, and the accuracy of the gravity heading."""
    return (
        f"With its offset stored, the gyro drifts by {abs(v['restored_bias']):.3f} deg/s. Gravity gives the "
        f"heading within {abs(v['corrected_heading']):.2f} deg."
    )


@procedure(
    name="imu_calibration",
    needs=("servos", "imu", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"rest_s": 20.0, "learn_s": 8.0, "headings": 4, "dwell_s": 1.0},
)
def run(ctx: Context) -> None:
    """IMU calibration: offsets stored and restored, noise by Allan deviation, heading from gravity."""
    p: Parameters = ctx.parameters
    if not ctx.source.config.environment.on_wall:
        raise ConfigError(
            f"bench {ctx.source.config.name} is not on a wall: gravity does not show the heading",
            expected="tilt_rad = 1.5708 in [environment]",
            remedy="run it on the wall bench",
        )
    if ctx.source.config.of(Bno055Config) is None:
        raise ConfigError(
            f"bench {ctx.source.config.name} has an IMU that keeps no offsets for a client to store",
            expected='model = "bno055" in [imu]',
            remedy="leave this procedure out",
        )
    bench = ctx.reopen(overrides={"tracker": None, "encoders": None})
    with ctx.step("learn", timeout_s=p.learn_s + 30.0):
        ctx.measure("gyro_level", learn(bench, p))
    with ctx.step("store"):
        stored, path = store(ctx, bench)
    with ctx.step("rest", timeout_s=p.rest_s + 60.0):
        rest(ctx, bench)
    with ctx.step("headings"):
        offset_rad = turn_and_compare(ctx, bench)
    with ctx.step("restore"):
        restore(ctx, stored, path, offset_rad)


def learn(bench: Bench, p: Parameters) -> float:
    """Rest until the chip reports a calibrated gyro, or time is over; return its calibration level."""
    enable_hold(bench)
    level = 0
    for _ in range(int(np.ceil(p.learn_s))):
        samples = [s for r in bench.observe(1.0, feedback="odometry").records for s in r.inputs.imu]
        level = samples[-1].calibration[1] if samples else 0
        if level >= _LEARNT:
            break
    return float(level)


def store(ctx: Context, bench: Bench) -> tuple[Any, Path]:
    """Read the offsets from the chip and store them in a file."""
    stored = cast(StoresOffsets, bench.devices.get("imu")).read_calibration()
    path = ctx.folder / "imu_offsets.toml"
    stored.save(path)
    ctx.attach("IMU offsets", path)
    for axis, counts in zip("xyz", stored.gyroscope_offset, strict=True):
        ctx.measure(f"gyro_offset_{axis}", counts * _GYRO_LSB_DEG_S)
    rows = [
        ["gyroscope", *(f"{c * _GYRO_LSB_DEG_S:+.4f}" for c in stored.gyroscope_offset), "deg/s"],
        ["accelerometer", *(f"{c * _GRAVITY_LSB_M_S2:+.2f}" for c in stored.accelerometer_offset), "m/s²"],
        ["magnetometer", *(f"{c / 16.0:+.1f}" for c in stored.magnetometer_offset), "µT"],
    ]
    ctx.table(
        "Stored offsets",
        ["sensor", "x", "y", "z", "unit"],
        rows,
        "Axes of the chip. The accelerometer only learns when it is held in several attitudes: by hand, "
        "off the wall.",
    )
    return stored, path


def rest(ctx: Context, bench: Bench) -> None:
    """Measure noise and bias of the turn rate, and noise of the accelerometer, at rest."""
    enable_hold(bench)
    data = inertial(bench.observe(ctx.parameters.rest_s, feedback="odometry"))
    if len(data) < 100:
        raise DeviceError("imu", f"{len(data)} usable samples at rest", remedy="hil run bring_up")
    period_s = float(np.median(np.diff(data.t_s)))
    curves = {
        axis: allan(evenly(data.t_s, data[k] * _DEG, period_s), period_s)
        for axis, k in zip("xyz", (2, 3, 4), strict=True)
    }
    normal = allan(evenly(data.t_s, data[0] * _DEG, period_s), period_s)
    density, spread = normal.white_noise()
    instability, at_s = normal.bias_instability()
    ctx.measure("gyro_bias", data.mean(0) * _DEG)
    ctx.measure("gyro_noise", density)
    ctx.measure("gyro_noise_uncertainty", 2.0 * spread)
    ctx.measure("gyro_bias_instability", 3600.0 * instability)
    force = (data.values[:, 5:8] + data.values[:, 8:11]) / _STANDARD_GRAVITY * 1e3
    densities = [allan(evenly(data.t_s, force[:, k], period_s), period_s).white_noise()[0] for k in range(3)]
    ctx.measure("accelerometer_noise", max(densities))
    if has_dead_zone(data.values[:, 2:5]):
        ctx.note(f"The gyro: {DEAD_ZONE}. Its turns and the offset of its heading are known.")
        return
    draw_allan(ctx, curves, density)
    ctx.note(
        f"The Allan deviation was lowest at {at_s:.3g} s of averaging. Noise includes the chip's resolution "
        f"of {_GYRO_LSB_DEG_S:g} deg/s."
    )


def turn_and_compare(ctx: Context, bench: Bench) -> float:
    """Dwell at several headings; return gravity minus motion capture at the mean heading, rad."""
    p: Parameters = ctx.parameters
    found, felt_rad, turned_rad = [], [], []
    pose = enable_hold(bench)
    path = turns(p, pose)
    for number, trajectory in enumerate(path):
        motion = bench.drive(trajectory, feedback="odometry", hold_s=0.3, start_pose=pose)
        rates = inertial(motion)
        felt_rad.append(float(integrated(rates.t_s, rates[0])[-1]) if len(rates) else 0.0)
        before, pose = pose, enable_hold(bench)
        turned_rad.append(float(pose[2] - before[2]))
        if number < len(path) - 1:
            found.append(_dwell(bench, p))
        ctx.progress("headings", number + 1, len(path))
    ctx.measure("gyro_response", float(np.dot(felt_rad, turned_rad) / np.dot(turned_rad, turned_rad)))
    true, seen = np.array(found).T
    error = wrap_array(seen - true)
    slope, _ = np.polyfit(true - true.mean(), error, 1)
    offset = float(error.mean())
    scatter = error - offset - slope * (true - true.mean())
    freedom = len(error) - 2
    sigma = np.hypot(
        np.sqrt(np.sum(scatter**2) / freedom), _GRAVITY_LSB_M_S2 / _STANDARD_GRAVITY / np.sqrt(12)
    )
    half = float(stdtrit(freedom, 0.975)) * sigma / np.sqrt(len(error))
    ctx.measure("heading_offset", offset * _DEG)
    ctx.measure("heading_offset_uncertainty", float(half) * _DEG)
    ctx.measure("heading_scatter", float(np.sqrt(np.mean(scatter**2))) * _DEG)
    draw_headings(ctx, true, error, offset, float(slope))
    return offset


def _dwell(bench: Bench, p: Parameters) -> tuple[float, float]:
    motion = bench.observe(p.dwell_s, feedback="odometry")
    truth, seen = poses(motion, "mocap"), inertial(motion)
    if not len(truth) or not len(seen):
        missing = "mocap" if not len(truth) else "imu"
        raise DeviceError(missing, "no usable samples at rest", remedy="hil run bring_up")
    return truth.mean(2), seen.mean(1)


def restore(ctx: Context, stored: Any, path: Path, offset_rad: float) -> None:
    """Restart the chip with the stored offsets and the corrected mount, and check both.

    Only the configuration changes, not the mount of an emulated chip.
    """
    config = ctx.source.config.of(Bno055Config)
    assert config is not None
    mount = quat_multiply(quat_from_yaw(offset_rad), config.mount_rotation_wxyz)
    emulation = ctx.source.config.imperfections("imu")
    values = {
        "imu": {"calibration_file": path.name, "mount_rotation_wxyz": [round(float(v), 6) for v in mount]}
    }
    bench = ctx.reopen(
        "restored",
        overrides={
            "tracker": None,
            "encoders": None,
            "imu.calibration_file": str(path),
            "imu.mount_rotation_wxyz": values["imu"]["mount_rotation_wxyz"],
            "emulation.imu": {"mount_rotation_wxyz": config.mount_rotation_wxyz, **emulation},
        },
    )
    back = cast(StoresOffsets, bench.devices.get("imu")).read_calibration()
    pairs = zip(
        (*stored.accelerometer_offset, *stored.magnetometer_offset, *stored.gyroscope_offset),
        (*back.accelerometer_offset, *back.magnetometer_offset, *back.gyroscope_offset),
        strict=True,
    )
    ctx.measure("restored_difference", max(abs(a - b) for a, b in pairs))
    enable_hold(bench)
    motion = bench.observe(max(ctx.parameters.dwell_s, 2.0), feedback="odometry")
    data, truth = inertial(motion), poses(motion, "mocap")
    ctx.measure("restored_bias", data.mean(0) * _DEG)
    ctx.measure("corrected_heading", (data.mean(1) - truth.mean(2)) * _DEG)
    write_fragment(ctx, values, "Offsets for the chip, written at every start, and the corrected mount.")
    measured = ctx.findings.values
    figures = {
        name: Figure(value=measured[name], sigma=sigma, unit=unit)
        for name, unit, sigma in (
            ("heading_offset", "deg", 0.5 * measured["heading_offset_uncertainty"]),
            ("gyro_noise", "deg/s/√Hz", 0.5 * measured["gyro_noise_uncertainty"]),
            ("gyro_bias", "deg/s", None),
            ("gyro_bias_instability", "deg/h", None),
            ("accelerometer_noise", "mg/√Hz", None),
        )
        if measured["gyro_noise"] > 0.0 or not name.startswith("gyro")
    }
    mounted = {"imu.mount_rotation_wxyz": values["imu"]["mount_rotation_wxyz"]}
    leave_part(ctx, "inertial", values=mounted, figures=figures, files={"imu.calibration_file": path})
