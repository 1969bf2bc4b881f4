"""Measures delays on the bench's clock: from command to motion, and from motion to the sample in the loop.

The robot turns to and fro by a few degrees, then its steering axes do. The signal of every device is fitted
to the commands: with its own time stamps, which gives their error, and with the arrival times, which gives
the age of the data in the loop. Body motion is that measured by motion capture.

Stamps are compared with those of motion capture and of the servos, which are assumed to be right. Stamps of
the inertial unit differ from run to run: its fusion runs at its own 100 Hz, so a driver knows its phase only
to half a period, and a loop of the same rate samples it at a constant phase.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.config.robot_record import Figure
from hil.controller.module_layer import ModuleLimits, optimize
from hil.core.geometry import Array
from hil.loop.driven_motion import Motion
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.needed_devices import only
from hil.procedure.record_parts import leave_part
from hil.procedure.sample_arrays import Series, encoders, inertial, integrated, poses, wheels
from hil.procedure.scripted_joints import Stretch, play
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.latency.fit import Command, Delay, fit_delay, fit_driven, fit_response, sent_s
from hil.procedures.latency.report import draw_chain, draw_signals, table
from hil.robot.kinematics import forward, inverse

Compared = Literal["encoders", "imu", "tracker"]
_GOLDEN = 0.6180339887498949
_STAMP_LIMIT_MS = {"encoders": 5.0, "imu": 8.0, "tracker": 8.0}
_TRUSTED_S = 0.0003
_TRUSTED = Delay(0.0, _TRUSTED_S, 1.0, 0.0)
_SLACK_RAD = math.radians(1.0)
_LONGEST_LAG_S, _TRUNCATION_S = 0.12, 0.0003
_HALF = "half of the 95 % interval"


class Parameters(BaseModel):
    """Devices to compare beside servos and motion capture, and size of the motions."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    devices: tuple[Compared, ...] = Field(
        ("encoders", "imu", "tracker"),
        description="Devices that are compared with the command, beside servos and motion capture.",
    )
    reversals: int = Field(
        24,
        ge=8,
        le=400,
        description="How often the command changes its direction; more of them give a narrower interval.",
    )
    drive_rad_s: float = Field(
        1.5, ge=0.3, le=4.0, description="Rate of the fastest wheel while the robot turns to and fro, rad/s."
    )
    steer_deg: float = Field(
        4.0, ge=1.0, le=15.0, description="How far the wheels are steered to either side, deg."
    )
    dwell_s: float = Field(0.4, ge=0.25, le=2.0, description="Mean time between two changes of direction, s.")


@dataclass(frozen=True)
class Signal:
    """One signal compared with the command.

    Attributes:
        t_s, path: time and path, for a figure.
        delay: delay behind the command, by its stamps.
        age_s: median age on arrival, by its stamps.
        stamp: delay of its stamps behind the reference; for the two references, their assumed accuracy.
    """

    t_s: Array
    path: Array
    delay: Delay
    age_s: float
    stamp: Delay = _TRUSTED

    @property
    def known_s(self) -> float:
        """Time from command to sample in the loop, independent of stamps: mean delay plus median age."""
        return self.delay.delay_s + self.age_s

    def against(self, truth: Signal) -> Signal:
        """Return the signal with the error of its stamps against another signal of the same motion."""
        half_s = math.hypot(self.delay.uncertainty_s, truth.delay.uncertainty_s)
        return replace(
            self,
            stamp=replace(self.delay, delay_s=self.delay.delay_s - truth.delay.delay_s, uncertainty_s=half_s),
        )


def measurements(p: Parameters) -> Iterator[Measurement]:
    """Yield the delays in ms, each with half of its 95 % interval."""
    for name, why in (
        ("body.command_to_motion", "bus, motors and tyres; recorded on the robot: 40 to 100"),
        ("wheels.command_to_motion", "as above, by the drives' own encoders"),
        ("steering.command_to_motion", "by the servos' encoders; a step of position"),
    ):
        yield Measurement(name, "ms", low=5.0, high=150.0, marginal=20.0, rationale=why)
        yield Measurement(f"{name}_uncertainty", "ms", high=2.0, rationale=_HALF)
    yield Measurement(
        "servos.velocity_lag",
        "ms",
        low=35.0,
        high=70.0,
        marginal=5.0,
        rationale="Present Velocity behind Present Position: 52 measured on the robot",
    )
    yield Measurement("servos.velocity_lag_uncertainty", "ms", high=4.0, rationale=_HALF)
    for name in ("servos", "mocap", *p.devices):
        yield Measurement(
            f"{name}.age", "ms", high=50.0, rationale="median from measurement to arrival, stamps corrected"
        )
        yield Measurement(f"{name}.age_uncertainty", "ms", high=4.0, rationale=_HALF)
        yield Measurement(
            f"{name}.command_to_known",
            "ms",
            high=200.0,
            marginal=20.0,
            rationale="from the command until the loop has the sample",
        )
        yield Measurement(f"{name}.command_to_known_uncertainty", "ms", high=4.0, rationale=_HALF)
    for name in p.devices:
        limit = _STAMP_LIMIT_MS[name]
        against = "the servos' steering" if name == "encoders" else "motion capture"
        phase = "; plus or minus half a period of its fusion" if name == "imu" else ""
        yield Measurement(
            f"{name}.stamp_error",
            "ms",
            low=-limit,
            high=limit,
            marginal=1.0,
            rationale=f"stamps later than the truth, against {against}{phase}",
        )
        yield Measurement(f"{name}.stamp_error_uncertainty", "ms", high=4.0, rationale=_HALF)
    yield Measurement(
        "worst_misfit", "1", high=0.25, marginal=0.05, rationale="share of a signal that no delay explains"
    )


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan small turns of the body, then of the steering axes."""
    yield PlannedStep("turns")
    yield PlannedStep("steering")
    yield PlannedStep("evaluate")


def headline(v: Mapping[str, float]) -> str:
    """Return the delay from command to motion, and the device with the latest sample."""
    known = {name.partition(".")[0]: t for name, t in v.items() if name.endswith(".command_to_known")}
    last = max(known, key=lambda name: known[name]) if known else ""
    message = f" The latest report is that of {last}, after {known[last]:.0f} ms." if last else ""
    return f"The body moves {v['body.command_to_motion']:.0f} ms after its command.{message}"


@procedure(
    name="latency",
    needs=("servos", "mocap"),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"reversals": 12},
)
def run(ctx: Context) -> None:
    """Latency: command to motion and motion to knowledge, per device, on the bench clock."""
    p: Parameters = ctx.parameters
    bench = ctx.reopen(overrides=only(ctx, ("servos", "mocap", *p.devices)))
    with ctx.step("turns", timeout_s=60.0 + 3.0 * p.reversals * p.dwell_s):
        turning = turn(bench, p)
    with ctx.step("steering", timeout_s=60.0 + 3.0 * p.reversals * p.dwell_s):
        steering = steer(bench, p)
    with ctx.step("evaluate"):
        evaluate(ctx, bench, turning, steering)


def dwells(p: Parameters, count: int) -> list[float]:
    """Return uneven dwells, in pairs so that to and fro cancel; even ones could hide a whole period."""
    pairs = [p.dwell_s * (0.75 + 0.5 * ((k * _GOLDEN) % 1.0)) for k in range((count + 1) // 2)]
    return [d for d in pairs for _ in range(2)]


def turn(bench: Bench, p: Parameters) -> Motion:
    """Turn the body to and fro about its current heading."""
    pose = enable_hold(bench)
    speed, angle = inverse(bench.geometry, np.array([0.0, 0.0, 1.0]))
    limits = ModuleLimits(steering_rad=bench.config.safety.steering_limit_rad)
    modules = [optimize(float(v), float(a), 0.0, limits) for v, a in zip(speed, angle, strict=True)]
    share = np.array([v for v, _ in modules]) / bench.geometry.radius_m
    rate, steering = p.drive_rad_s * share / np.abs(share).max(), np.array([a for _, a in modules])
    now = wheels(bench.observe(0.1, feedback="odometry")).values[-1, 8:12]
    play(bench, [Stretch(1.0, steering_rad=steering), Stretch(0.3)], pose, now)
    times = dwells(p, p.reversals)
    signs = [1.0 if k % 2 == 0 else -1.0 for k in range(len(times))]
    halved = [0.5 * times[0], *times[1:], 0.5 * times[-1]]
    signs.append(-signs[-1])
    script = [Stretch(d, w * rate) for d, w in zip(halved, signs, strict=True)]
    return play(bench, [*script, Stretch(0.5)], pose, steering)


def steer(bench: Bench, p: Parameters) -> Motion:
    """Turn all steering axes to and fro in steps; the wheels do not roll."""
    pose = enable_hold(bench)
    now = wheels(bench.observe(0.1, feedback="odometry")).values[-1, 8:12]
    play(bench, [Stretch(1.0, steering_rad=np.zeros(4)), Stretch(0.3)], pose, now)
    step = np.radians(p.steer_deg)
    script = [
        Stretch(d, steering_rad=np.full(4, step if k % 2 == 0 else -step), ramp=False)
        for k, d in enumerate(dwells(p, p.reversals))
    ]
    return play(bench, [*script, Stretch(0.5, steering_rad=np.zeros(4), ramp=False)], pose, np.zeros(4))


def body_signals(bench: Bench, motion: Motion, p: Parameters) -> tuple[Command, dict[str, Signal]]:
    """Return the commanded heading, and the heading that every device measured."""
    geometry = bench.geometry
    rates = np.array([r.setpoint.wheel_rate_rad_s for r in motion.records])
    angles = np.array([r.setpoint.steering_rad for r in motion.records])
    command = Command(sent_s(motion), forward(geometry, rates * geometry.radius_m, angles)[:, 2])
    rolled = wheels(motion).since(0.0)
    steps = np.diff(rolled.values[:, 0:4], axis=0, prepend=rolled.values[:1, 0:4]) * geometry.radius_m
    by_angle = np.cumsum(forward(geometry, steps, rolled.values[:, 8:12])[:, 2])
    speed = forward(geometry, rolled.values[:, 4:8] * geometry.radius_m, rolled.values[:, 8:12])[:, 2]
    servos = _signal(command, rolled, by_angle)
    by_speed = integrated(rolled.t_s, speed)
    lag = fit_response(rolled.t_s, by_angle, by_speed, _LONGEST_LAG_S)
    lag = replace(lag, uncertainty_s=math.hypot(lag.uncertainty_s, _TRUNCATION_S))
    found = {"servos": servos, "velocity register": replace(_signal(command, rolled, by_speed), stamp=lag)}
    seen = poses(motion, "mocap").since(0.0)
    mocap = _signal(command, seen, seen[2])
    if "imu" in p.devices:
        data = inertial(motion).since(0.0)
        found["imu"] = _signal(command, data, integrated(data.t_s, data[0])).against(mocap)
    if "tracker" in p.devices:
        data = poses(motion, "tracker").since(0.0)
        found["tracker"] = _signal(command, data, data[2]).against(mocap)
    return command, {**found, "mocap": mocap}


def steering_signals(bench: Bench, motion: Motion, p: Parameters) -> tuple[Command, dict[str, Signal]]:
    """Return the mean steering angle, integrated over time: commanded, and from servos and encoders."""
    angles = np.array([r.setpoint.steering_rad for r in motion.records]).mean(axis=1)
    command = Command(sent_s(motion), angles)
    rolled = wheels(motion).since(0.0)
    driving = rolled.values[:, 8:12]
    servos = _signal(command, rolled, integrated(rolled.t_s, driving.mean(axis=1)))
    found = {"servos": servos}
    if "encoders" in p.devices:
        data = encoders(motion, bench.config).since(0.0)
        whole = np.isfinite(data.values).all(axis=1)
        t_s, mean = data.t_s[whole], data.values[whole].mean(axis=1)
        path = integrated(t_s, mean)
        own = Signal(t_s, path, fit_delay(command, t_s, path), _age_s(data))
        stamp = fit_driven(
            rolled.t_s,
            driving,
            data.t_s,
            data.values,
            slack_rad=min(_SLACK_RAD, 0.5 * math.radians(p.steer_deg)),
            about_s=own.delay.delay_s - servos.delay.delay_s,
        )
        found["encoders"] = replace(own, stamp=stamp)
    return command, found


def _signal(command: Command, series: Series, path: Array) -> Signal:
    return Signal(series.t_s, path, fit_delay(command, series.t_s, path), _age_s(series))


def _age_s(series: Series) -> float:
    return float(np.median(series.host_s - series.t_s)) if len(series) else float("nan")


def values_ms(p: Parameters, body: Mapping[str, Signal], axes: Mapping[str, Signal]) -> dict[str, float]:
    """Return every measured delay by its name, each with half of its 95 % interval, ms."""
    found: dict[str, float] = {}

    def note(name: str, delay_s: float, half_s: float) -> None:
        found[name], found[f"{name}_uncertainty"] = 1e3 * delay_s, 1e3 * half_s

    for name, signal in (("body", body["mocap"]), ("wheels", body["servos"]), ("steering", axes["servos"])):
        note(f"{name}.command_to_motion", signal.delay.delay_s, signal.delay.uncertainty_s)
    lag = body["velocity register"].stamp
    note("servos.velocity_lag", lag.delay_s, lag.uncertainty_s)
    for name in ("servos", "mocap", *p.devices):
        signal = axes[name] if name == "encoders" else body[name]
        stamp = signal.stamp
        note(f"{name}.age", signal.age_s + stamp.delay_s, max(stamp.uncertainty_s, _TRUSTED_S))
        note(f"{name}.command_to_known", signal.known_s, signal.delay.uncertainty_s)
        if name in p.devices:
            note(f"{name}.stamp_error", stamp.delay_s, stamp.uncertainty_s)
    return found


def evaluate(ctx: Context, bench: Bench, turning: Motion, steering: Motion) -> None:
    """Set measurements; leave table and figures."""
    p: Parameters = ctx.parameters
    command, body = body_signals(bench, turning, p)
    axis_command, axes = steering_signals(bench, steering, p)
    measured_ms = values_ms(p, body, axes)
    for name, value in measured_ms.items():
        ctx.measure(name, value)
    every: Mapping[str, Signal] = {**body, **{f"{n}, steering": s for n, s in axes.items()}}
    ctx.measure("worst_misfit", max(s.delay.misfit for s in every.values()))
    table(ctx, {n: (s.delay, s.age_s) for n, s in every.items()})
    draw_chain(ctx, {n: (s.delay, s.age_s) for n, s in every.items()})
    shown = {n: (s.t_s, s.path, s.delay) for n, s in body.items()}
    draw_signals(ctx, command.path, shown, "Turning to and fro", "heading (deg)", float(np.degrees(1.0)))
    shown = {n: (s.t_s, s.path, s.delay) for n, s in axes.items()}
    draw_signals(
        ctx,
        axis_command.path,
        shown,
        "Steering to and fro",
        "sum of the angle (deg s)",
        float(np.degrees(1.0)),
    )
    leave_part(ctx, "delays", figures=_figures(measured_ms))


def _figures(measured_ms: Mapping[str, float]) -> dict[str, Figure]:
    """Return the delays with their standard uncertainties, in s."""
    half_ms = {name: measured_ms.get(f"{name}_uncertainty") for name in measured_ms}
    return {
        name: Figure(value=1e-3 * value, sigma=None if half is None else 0.5e-3 * half, unit="s")
        for name, value in measured_ms.items()
        if not name.endswith("_uncertainty") and math.isfinite(value)
        for half in (half_ms[name],)
    }
