"""The first run on a bench, and after every change to it: checks that all devices work with the right signs.

It checks which devices answer, with which firmware and limits; the rate and jitter of the samples; the drift
of the devices' clocks; and, by motions of millimetres, the direction of every drive, steering axis, encoder,
gyro and camera against the configured signs. Corrected signs are left as a fragment of `bench.toml`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hil.bench import Bench
from hil.bench.cross_checks.parameters import advice
from hil.bench.doctor.steering_offsets import encoder_minus_servo
from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.config.robot_record.parts import part_of
from hil.core.cross_check import CrossCheck
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.registry import kinds
from hil.core.signals import KINDS, WHEELS
from hil.loop.driven_motion import Motion
from hil.procedure import Context, Measurement, PlannedStep, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.needed_devices import Device, only
from hil.procedure.record_parts import leave_part
from hil.procedure.sample_arrays import inertial, integrated, poses
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.bring_up.body_sensor import wrong_axes, wrong_place, wrong_turns
from hil.procedures.bring_up.body_steps import camera_checks, steered_off, step_checks
from hil.procedures.bring_up.jogs import (
    DriveJogs,
    SteerJogs,
    find_signs,
    jog_drives,
    jog_steering,
    reversed_names,
)
from hil.procedures.bring_up.plane import LOOK_AT
from hil.procedures.bring_up.report import (
    draw_clocks,
    draw_directions,
    draw_streams,
    note_exchanged,
    note_explanation,
    note_other_values,
    stream_table,
)
from hil.procedures.bring_up.streams import Stream, judge_stream
from hil.procedures.bring_up.turn_axis import place_checks, turn_checks
from hil.robot.trajectories import Trajectory, line

_DEG = float(np.degrees(1.0))
_PUSHES = 0.5
"""Least cosine between measured and expected push of a drive."""
_CLEAR = 0.5
"""Least measured value of a clear direction: below it something else moved, or hardly anything."""
_MOST_DRIFT_PPM, _NOTHING_KNOWN_PPM = 90.0, 1e6
_SHOWN_BY_MOTION = {
    "alignment": ("drive_sign", "steer_sign"),
    "servos": ("drive_ids", "steer_ids"),
    "encoders": ("sign", "signals"),
    "mocap": ("up_axis",),
}
"""Keys that are right if every joint and sensor goes the right way, by table."""
_GENTLE_M_S2 = 0.12
"""Wheel acceleration of the small steps, within the limits of larger robots, too."""


class Parameters(BaseModel):
    """Required devices, observation time, and size of the motions."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    devices: tuple[Device, ...] = Field(KINDS, description="Devices that must be there and answer.")
    watch_s: float = Field(
        20.0, ge=2.0, le=600, description="How long the robot stands while its samples are counted, s."
    )
    steer_deg: float = Field(
        5.0, ge=2.0, le=20, description="How far each wheel is steered to see whether it answers, deg."
    )
    drive_rad_s: float = Field(
        0.5, ge=0.2, le=2.0, description="How fast each wheel is turned to see whether it answers, rad/s."
    )
    step_m: float = Field(0.04, ge=0.02, le=0.5, description="How far the body moves along X and along Y, m.")
    turn_deg: float = Field(6.0, ge=3.0, le=12.0, description="How far the body turns, deg.")

    @property
    def body(self) -> str:
        """Device whose poses show the motion of the body."""
        return "mocap" if "mocap" in self.devices else "tracker"

    @model_validator(mode="after")
    def _enough(self) -> Parameters:
        if "servos" not in self.devices or not {"mocap", "tracker"} & set(self.devices):
            raise ValueError("devices must hold servos, and mocap or tracker to see the body move")
        return self


def age_limit_ms(name: str, config: BenchConfig) -> float:
    """Return the age limit of samples on arrival, ms: transport time, plus one cycle if samples wait.

    CAN frames and prefetched samples wait for the loop in a queue.
    """
    device = config.devices().get(name)
    waits = device is not None and device.waits_for_loop()
    return 1e3 * kinds()[name].max_age_s + (1e3 / config.loop.rate_hz if waits else 0.0)


def measurements(p: Parameters, config: BenchConfig) -> Iterator[Measurement]:
    """Yield the measurements of each device and each joint."""
    yield Measurement("devices", "1", low=float(len(p.devices)), rationale="opened and identified themselves")
    yield Measurement(
        "servos.failed_checks", "1", high=0.0, rationale="hardware errors and the like; see the table"
    )
    yield Measurement("servos.warnings", "1", rationale="firmware, delays, limits; see the table")
    yield Measurement("servos.supply_lowest", "V", low=9.5, marginal=0.5, rationale="servos switch off below")
    yield Measurement(
        "loop.largest_gap", "ms", rationale="between two cycles; samples that miss then miss by this computer"
    )
    yield Measurement("servos.hottest", "degC", high=70.0, marginal=5.0, rationale="servos switch off at 80")
    for name in p.devices:
        yield Measurement(f"{name}.rate", "Hz", rationale="usable samples")
        yield Measurement(
            f"{name}.delivered",
            "1",
            low=kinds()[name].min_delivered,
            marginal=0.01,
            rationale="usable of expected",
        )
        yield Measurement(
            f"{name}.largest_gap",
            "ms",
            high=1e3 * kinds()[name].max_gap_s,
            rationale="a longer one harms the estimate or makes the supervisor stop",
        )
        yield Measurement(
            f"{name}.age",
            "ms",
            low=0.0,
            high=age_limit_ms(name, config),
            rationale="median from measurement to arrival; one cycle more where samples wait for the loop",
        )
        if kinds()[name].has_own_clock:
            yield Measurement(
                f"{name}.clock_drift", "ppm", rationale="device clock against bench clock, positive is fast"
            )
            yield Measurement(f"{name}.clock_drift_uncertainty", "ppm", rationale="half of the 95 % interval")
            yield Measurement(
                f"{name}.clock_drift_least",
                "ppm",
                high=_MOST_DRIFT_PPM,
                marginal=10.0,
                rationale="size of the drift less its uncertainty; drivers follow up to 100",
            )
    yield Measurement(
        "contradicted",
        "1",
        high=0.0,
        rationale="keys of the bench file that sensors contradict and no procedure finds; nothing is moved",
    )
    yield from _of_directions(p)
    yield Measurement(
        "contradicted_by_steps",
        "1",
        high=0.0,
        rationale="keys of the bench file that the steps of the body contradict and no procedure finds",
    )


def _of_directions(p: Parameters) -> Iterator[Measurement]:
    for wheel in WHEELS:
        yield Measurement(
            f"steer_{wheel}.servo_response", "1", low=0.9, high=1.1, rationale="angle turned over commanded"
        )
        if "encoders" in p.devices:
            yield Measurement(
                f"steer_{wheel}.encoder_response",
                "1",
                low=0.85,
                high=1.15,
                marginal=0.03,
                rationale="backlash and an eccentric magnet cost 8 %; a wrong axis or sign is far outside",
            )
        for way in ("straight", "across"):
            yield Measurement(
                f"drive_{wheel}.{way}",
                "1",
                low=_PUSHES,
                marginal=0.1,
                rationale="cosine of push and expected push; -1: reversed, near 0: another wheel",
            )
    yield Measurement("steering.crosstalk", "1", high=0.1, rationale="turn of an axis that was not commanded")
    sensors = ["odometry"] + ["tracker"] * ("tracker" in p.devices and p.body != "tracker")
    for name in sensors:
        for axis in ("x", "y", "heading"):
            # tracker_extrinsics finds a scale of 0.7 to 1.35; a few centimetres show it to a tenth
            low, high = (0.6, 1.45) if name == "tracker" and axis != "heading" else (0.7, 1.3)
            yield Measurement(
                f"{name}.{axis}_response",
                "1",
                low=low,
                high=high,
                marginal=0.05,
                rationale=f"motion seen over motion seen by {p.body}; slip costs some",
            )
    if "imu" in p.devices:
        yield Measurement(
            "imu.gyro_response", "1", low=0.9, high=1.1, marginal=0.03, rationale="turn over the body's turn"
        )


def steps(p: Parameters, start: Array) -> list[Trajectory]:
    """Return small motions of the body: forwards, to the left, and a turn."""
    pose = np.asarray(start, dtype=np.float64)
    ways = {"x": [p.step_m, 0.0, 0.0], "y": [0.0, p.step_m, 0.0], "heading": [0.0, 0.0, p.turn_deg / _DEG]}
    return [
        line(pose, pose + way, speed_m_s=0.05, acceleration_m_s2=_GENTLE_M_S2, name=f"step {name}")
        for name, way in ways.items()
    ]


def plan(p: Parameters, config: BenchConfig) -> Iterable[PlannedStep]:
    """Plan all steps; only the last one follows trajectories."""
    for title in ("identity", "streams", "steering", "drives"):
        yield PlannedStep(title)
    yield PlannedStep("body", tuple(steps(p, np.array(config.environment.start_pose))))


def headline(v: Mapping[str, float]) -> str:
    """Return how many kinds of devices answered, and whether their directions are right."""
    reported = ("_response", ".straight", ".across")
    ways = {name: value for name, value in v.items() if name.endswith(reported)}
    turned = sum(value <= -_CLEAR for value in ways.values())
    unclear = sum(abs(value) < _CLEAR for value in ways.values())
    way = "whatever moved went the right way" if ways else "nothing was moved"
    if turned or unclear:
        both = ((turned, "reversed"), (unclear, "not as expected"))
        found = " and ".join(f"{count} {how}" for count, how in both if count)
        way = found.replace(" ", " of their directions are ", 1)
    return f"{v['devices']:.0f} kinds of device answered, and {way}."


@procedure(
    name="bring_up",
    needs=("servos",),
    parameters=Parameters,
    measurements=measurements,
    plan=plan,
    headline=headline,
    quick={"watch_s": 5.0},
)
def run(ctx: Context) -> None:
    """Bring-up: identity, limits, sample rates, clocks, and every direction by a small motion."""
    p: Parameters = ctx.parameters
    bench = ctx.reopen(overrides=only(ctx, p.devices))
    with ctx.step("identity"):
        identify(ctx, bench)
    with ctx.step("streams", timeout_s=p.watch_s + 30.0):
        watch(ctx, bench)
    wrong = bench.parameters.not_to_be_found()
    ctx.measure("contradicted", len(wrong))
    if wrong:
        ctx.note(f"Nothing was moved: {'; '.join(dict.fromkeys(check.text for check in wrong))}.")
        return
    with ctx.step("steering", timeout_s=60.0):
        steer = jog_steering(bench, p.steer_deg / _DEG)
        _measure_steering(ctx, steer)
    with ctx.step("drives", timeout_s=120.0):
        straight = jog_drives(bench, p.body, 0.0, p.drive_rad_s)
        across = jog_drives(bench, p.body, np.pi / 2.0, p.drive_rad_s)
        if across.off_plane:
            seen = " and ".join(LOOK_AT[name] for name in across.off_plane)
            ctx.note(
                f"By {kinds()[p.body].noun} the robot leaves its plane while the wheels roll on it: look at "
                f"{seen}. No direction was judged."
            )
            return
        if turned := wrong_turns(p.body, straight, across) or wrong_axes(p.body, straight, across):
            ctx.note(f"{turned} No direction was judged.")
            return
        _measure_drives(ctx, straight, across, steer)
    if not ctx.passing():
        if moved := wrong_place(p.body, straight, across):
            ctx.note(moved)
        ctx.note("The body was not moved: first correct everything that failed above.")
        return
    with ctx.step("body", timeout_s=120.0):
        shown = move_body(ctx, bench)
    told: dict[str, list[str]] = {}
    for check in bench.parameters.take(check for check in shown if check.state == "contradicted"):
        told.setdefault(check.text, []).append(advice(check))
    for text, remedies in told.items():
        ctx.note(f"{text}; {' or '.join(remedies)}.")
    wrong = [check for check in shown if check.state == "contradicted" and part_of(check.key) is None]
    ctx.measure("contradicted_by_steps", len(wrong))
    leave_part(ctx, "signs", values=_signs(ctx))
    if ctx.passing():
        bench.parameters.take([*_confirmed(ctx), *shown])


def _confirmed(ctx: Context) -> Iterator[CrossCheck]:
    """Yield the choices of the bench file, as signs, that small motions confirm."""
    config = ctx.source.config
    tables = {**config.devices(), "alignment": config.alignment}
    for table, keys in _SHOWN_BY_MOTION.items():
        if table in ("alignment", *ctx.parameters.devices):
            for key in keys:
                if (value := getattr(tables[table], key)) is not None:
                    yield CrossCheck(f"{table}.{key}", value, "confirmed", "small motions", value)


def _signs(ctx: Context) -> dict[str, Any]:
    """Return the configured signs, once they are confirmed."""
    config = ctx.source.config
    encoders = config.of(EncodersConfig)
    values: dict[str, Any] = {
        "alignment.drive_sign": list(config.alignment.drive_sign),
        "alignment.steer_sign": list(config.alignment.steer_sign),
    }
    if "encoders" in ctx.parameters.devices and encoders is not None:
        values["encoders.sign"] = list(encoders.sign)
    return values


def identify(ctx: Context, bench: Bench) -> None:
    """Check the identities of the devices, and the registers of the servos."""
    found = {d.name: dict(d.identity()) for d in bench.devices.devices()}
    ctx.measure("devices", sum(bool(f) for f in found.values()))
    rows = [
        [name, facts.pop("model", ""), "; ".join(f"{key} {value}" for key, value in facts.items())]
        for name, facts in found.items()
    ]
    ctx.table("Devices", ["device", "model", "found"], rows)
    findings: tuple[Finding, ...] = getattr(bench.devices.actuators(), "diagnose", tuple)()
    ctx.measure("servos.failed_checks", sum(f.level == "failure" for f in findings))
    ctx.measure("servos.warnings", sum(f.level == "warning" for f in findings))
    ctx.table(
        "Servo registers",
        ["check", "level", "found", "expected", "remedy if not"],
        [[f.check, f.level, f.found, f.expected, f.remedy if f.level != "ok" else ""] for f in findings],
    )


def watch(ctx: Context, bench: Bench) -> None:
    """Rest and measure the streams of all devices."""
    p: Parameters = ctx.parameters
    enable_hold(bench)
    motion = bench.observe(p.watch_s, feedback="odometry")
    _measure_punctuality(ctx, motion)
    streams: dict[str, Stream] = {name: judge_stream(name, motion, bench.config) for name in p.devices}
    for name, stream in streams.items():
        _measure_stream(ctx, name, stream)
    health = [h for r in motion.records for h in r.inputs.health]
    ctx.measure("servos.supply_lowest", min((np.nanmin(h.voltage_v) for h in health), default=np.nan))
    ctx.measure("servos.hottest", max((np.nanmax(h.temperature_c) for h in health), default=np.nan))
    stream_table(ctx, streams)
    draw_streams(ctx, streams)
    draw_clocks(ctx, streams)
    _keep_steering(ctx, motion)


def _keep_steering(ctx: Context, motion: Motion) -> None:
    """Store the offsets of external encoders and servos at rest, for comparison in later sessions."""
    encoders = [s for r in motion.records for s in r.inputs.encoders]
    servos = [s for r in motion.records for s in r.inputs.servos]
    offsets_rad = encoder_minus_servo(ctx.source.config, encoders, servos)
    if np.isfinite(offsets_rad).all():
        leave_part(ctx, "steering", values={"encoders.minus_servo_rad": list(offsets_rad)})


def _measure_punctuality(ctx: Context, motion: Motion) -> None:
    """Measure how late this computer's loop was; samples missed then are not the devices' fault."""
    between_s = float(np.diff(motion.t_s).max(initial=0.0))
    ctx.measure("loop.largest_gap", 1e3 * between_s)
    if between_s > 1.5 / ctx.source.config.loop.rate_hz:
        ctx.note(
            f"This computer was late itself: up to {1e3 * between_s:.0f} ms passed between two cycles. Gaps "
            "of that size, and samples missing then, are not the devices' fault. `hil doctor` shows remedies."
        )


def _measure_stream(ctx: Context, name: str, stream: Stream) -> None:
    ctx.measure(f"{name}.rate", stream.rate_hz)
    ctx.measure(f"{name}.delivered", stream.delivered)
    ctx.measure(f"{name}.largest_gap", 1e3 * stream.gap_s[2])
    ctx.measure(f"{name}.age", 1e3 * stream.age_s[0])
    limit_ms = age_limit_ms(name, ctx.source.config)
    for key in ("latency_s", "transit_s", "sample_age_s"):  # the bench file's, added to what was measured
        taken_ms = 1e3 * getattr(ctx.source.config.devices()[name], key, 0.0)
        if 1e3 * stream.age_s[0] > limit_ms and 2.0 * taken_ms > limit_ms:
            ctx.note(
                f"{name}: {taken_ms:.0f} ms of its age are what the bench file says: look at {name}.{key}."
            )
    if kinds()[name].has_own_clock:
        drift_ppm, uncertain_ppm = stream.drift_ppm, stream.drift_uncertainty_ppm
        if stream.too_short:
            drift_ppm, uncertain_ppm = 0.0, _NOTHING_KNOWN_PPM
        ctx.measure(f"{name}.clock_drift", drift_ppm)
        ctx.measure(f"{name}.clock_drift_uncertainty", uncertain_ppm)
        ctx.measure(f"{name}.clock_drift_least", max(0.0, abs(drift_ppm) - uncertain_ppm))
        if uncertain_ppm > _MOST_DRIFT_PPM:
            ctx.note(
                f"{name}: the drift of its clock is not known: too few samples, or they came too unevenly. "
                "Watch it for longer (--set watch_s=60), on a computer that does nothing else."
            )


def _measure_steering(ctx: Context, steer: SteerJogs) -> None:
    others = ~np.eye(4, dtype=bool)
    crosstalk = np.abs(steer.servo[others]).max()
    for k, wheel in enumerate(WHEELS):
        ctx.measure(f"steer_{wheel}.servo_response", steer.servo[k, k])
        if "encoders" in ctx.parameters.devices:
            ctx.measure(f"steer_{wheel}.encoder_response", steer.encoder[k, k])
    if "encoders" in ctx.parameters.devices:
        crosstalk = max(crosstalk, np.abs(steer.encoder[others]).max())
        rows = [[f"commanded {w}", *(f"{v:+.3f}" for v in steer.encoder[:, k])] for k, w in enumerate(WHEELS)]
        ctx.table("Encoder turn over commanded turn", ["", *WHEELS], rows)
    ctx.measure("steering.crosstalk", crosstalk)


def _measure_drives(ctx: Context, straight: DriveJogs, across: DriveJogs, steer: SteerJogs) -> None:
    for way, jogs in (("straight", straight), ("across", across)):
        for wheel, cosine in zip(WHEELS, jogs.agreement(), strict=True):
            ctx.measure(f"drive_{wheel}.{way}", cosine)
    draw_directions(ctx, (straight, across))
    signs, config = find_signs(straight, across, steer), ctx.source.config
    named = note_exchanged(ctx, straight, across, steer)
    reported = reversed_names(signs.drive, "drive") + reversed_names(signs.steer, "steering")
    values: dict[str, dict[str, Any]] = {
        "alignment": {
            "drive_sign": _turned(config.alignment.drive_sign, signs.drive),
            "steer_sign": _turned(config.alignment.steer_sign, signs.steer),
        }
    }
    encoders = config.of(EncodersConfig)
    if "encoders" in ctx.parameters.devices and encoders is not None:
        reported += reversed_names(signs.encoder, "encoder")
        values["encoders"] = {"sign": _turned(encoders.sign, signs.encoder)}
    note_other_values(ctx, values)
    reported = [name for name in reported if name.split()[1] not in named]
    others = "all others" if named else "all"
    if reported or named or min(straight.agreement().min(), across.agreement().min()) >= _PUSHES:
        ctx.note("Directions: " + (", ".join(reported) if reported else f"{others} as configured") + ".")
    write_fragment(ctx, values, "Signs as found by small motions; unclear ones are left as they were.")


def _turned(configured: tuple[int, ...], found: Array) -> list[int]:
    return [c * (int(f) or 1) for c, f in zip(configured, found, strict=True)]


def move_body(ctx: Context, bench: Bench) -> list[CrossCheck]:
    """Move the body a little along each axis and compare the sensors.

    Returns:
        What the steps say of the bench file.
    """
    p: Parameters = ctx.parameters
    sources = [name for name in ("mocap", "tracker") if name in p.devices]
    ways = {name: np.zeros((3, 3)) for name in ("odometry", *sources)}
    rows, off, found = [], np.full(4, np.nan), list[CrossCheck]()
    for axis, name in enumerate(("x", "y", "heading")):
        pose = enable_hold(bench)
        motion = bench.drive(steps(p, pose)[axis], feedback="odometry", hold_s=0.5, start_pose=pose)
        ways["odometry"][axis] = _by_wheels(motion)
        for source in sources:
            ways[source][axis] = [_went(motion, source, k) for k in range(3)]
        true = float(ways[p.body][axis, axis])
        row = [name, f"{true * (_DEG if axis == 2 else 1e3):+.2f}"]
        seen = {sensor: float(way[axis, axis]) for sensor, way in ways.items() if sensor != p.body}
        for sensor, went in seen.items():
            ctx.measure(f"{sensor}.{name}_response", went / true)
            note_explanation(ctx, "servos" if sensor == "odometry" else sensor, went / true, axis)
            row.append(f"{went * (_DEG if axis == 2 else 1e3):+.2f}")
        if axis == 2 and "imu" in p.devices:
            data = inertial(motion)
            response = float(integrated(data.t_s, data[0])[-1]) / true
            ctx.measure("imu.gyro_response", response)
            note_explanation(ctx, "imu", response, axis)
        if axis == 0 and "encoders" in p.devices:
            off = steered_off(bench.config, motion)
        if axis == 2:
            found = _compare_axes(ctx, bench, motion, true)
        rows.append(row)
    head = ["step", p.body, *seen]
    ctx.table("Small steps of the body", head, rows, "mm, and deg for the turn.")
    judged = step_checks(bench.config, ways, off) if p.body == "mocap" else camera_checks(bench.config, ways)
    parts = 3 if bench.config.environment.on_wall else 2
    return list(_mounts(bench, [*found, *judged], {"tracker.mount_rotation_wxyz": parts}))


def _compare_axes(ctx: Context, bench: Bench, motion: Motion, turned_rad: float) -> list[CrossCheck]:
    """Compare the axis of a turn by IMU and camera with the normal of the surface, and the camera's place."""
    found = list(turn_checks(bench.config, motion, turned_rad))
    if bench.has("tracker") and ctx.parameters.body == "mocap":
        seen_m, true_m = (
            complex(_went(motion, name, 0), _went(motion, name, 1)) for name in ("tracker", "mocap")
        )
        found += place_checks(bench.config, abs(seen_m - true_m) / abs(turned_rad))
    return found


def _mounts(bench: Bench, found: Sequence[CrossCheck], needed: Mapping[str, int]) -> Iterator[CrossCheck]:
    """Yield the results; of mounts a whole one, where gravity, a turn, and steps have each shown a part.

    Args:
        bench: the bench, which has asked gravity.
        found: results of steps and turns; those of a part have a `beside`.
        needed: number of parts that make a whole mount, by key.
    """
    parts: dict[str, list[CrossCheck]] = {}
    for check in found:
        if check.beside:
            parts.setdefault(check.key, []).append(check)
        else:
            yield check
    for key, some in parts.items():
        whole = [*filter(None, [bench.parameters.partly(key)]), *some]
        if len(whole) >= needed.get(key, 2):
            off_rad = max((part.difference for part in whole), key=abs)
            within = max(part.within for part in whole)
            yield some[0]._replace(beside="", difference=off_rad, within=within)


def _by_wheels(motion: Motion) -> Array:
    """Return the step (3,) by the wheels, m, m, rad, in body axes at the start."""
    first, last = motion.estimate[0], motion.estimate[-1]
    c, s = np.cos(first[2]), np.sin(first[2])
    dx, dy, turn = last - first
    return np.array([c * dx + s * dy, c * dy - s * dx, turn])


def _went(motion: Motion, source: str, axis: int) -> float:
    """Return the change of one coordinate, in body axes at the start, from the first to the last 0.2 s."""
    series, end_s = poses(motion, source), float(motion.t_s[-1])
    first, last = series.between(-1.0, 0.1), series.between(end_s - 0.2, end_s + 1.0)
    if axis == 2:
        return float(last[2] - first[2])
    start = float(poses(motion, source).between(-1.0, 0.1)[2]) if source == "mocap" else 0.0
    c, s = np.cos(start), np.sin(start)
    dx, dy = (last - first)[:2]
    return float((c * dx + s * dy, c * dy - s * dx)[axis])
