"""Measures delays: the age of samples on arrival, and the time from a command to the turn of the axes.

This is all that can be measured on a stand. The delay from a command to the motion of the body, and the stamp
error of each device, are measured by the procedure `latency` with the robot on its wheels.
"""

from collections.abc import Iterator

import numpy as np

from hil.bench.bench import Bench
from hil.bench.contract.device_under_test import Broken, Subject, oldest_s
from hil.bench.contract.in_motion import at_loop_rate, enabled, fresh, still
from hil.bench.loop_settings import real_time
from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, MonotonicClock, nanoseconds
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import ServoSample, ServoSetpoint, Status, worst
from hil.loop.realtime import idle_loop
from hil.loop.timing import LoopStatistics

_TURN_RAD, _RATE_RAD_S, _LASTS_S, _TIMES = 0.07, 1.0, 0.6, 4
BUSY_SHARE, _IDLE_S = 0.05, 2.0
_LEAST_S, _MOST_S = 0.005, 0.15
_APART_S = 0.03
"""Because of backlash the encoders turn some milliseconds after the servos."""
_BUS = "check baud rates, latency timer and servos.reply_slack_s; then hil run latency, on the wheels"


def delays_at_rest(subject: Subject) -> str:
    """Report median and 95th percentile of the samples' age by their stamps, and the duration of reads.

    Raises:
        Broken: the samples are older than those of a healthy device.
    """
    watched = subject.watched
    stamps = [s.stamp for s in watched.samples if worst(s) is Status.OK]
    limit_s = oldest_s(subject.bench.config, subject.kind)
    if not stamps:
        raise Broken(
            "no good sample", f"samples younger than {1e3 * limit_s:.3g} ms", "see `samples in time`"
        )
    age_ms = np.array([s.host_ns - s.t_ns for s in stamps]) * 1e-6
    median, late = float(np.median(age_ms)), float(np.percentile(age_ms, 95))
    read = 1e3 * float(np.percentile(watched.took_s, 99))
    message = f"{median:.2f} ms old (95 %: {late:.2f} ms), read in {read:.2f} ms (99 %)"
    if median >= 1e3 * limit_s:
        raise Broken(
            message, f"younger than {1e3 * limit_s:.3g} ms", "look at USB latency timer, hub and network"
        )
    return message


def punctuality(config: BenchConfig) -> Finding:
    """Measure the timing jitter of this computer by an idle loop at the bench's rate, in real time."""
    found = idle_for(config, _IDLE_S)
    late = found.late / max(found.cycles, 1)
    return Finding(
        "bench",
        "this computer",
        "ok" if late <= BUSY_SHARE else "warning",
        f"{found.late} of {found.cycles} cycles of a loop that does nothing began late",
        f"at most {BUSY_SHARE:.0%}",
        ""
        if late <= BUSY_SHARE
        else "end other programs, set loop.fifo_priority, then accept again: "
        "this computer may be what delays samples",
    )


def idle_for(config: BenchConfig, seconds: float) -> LoopStatistics:
    """Timing statistics of an idle loop at the bench's rate, in real time."""
    clock = MonotonicClock()
    scheduling = real_time(config, clock)
    assert scheduling is not None
    loop = config.loop
    return idle_loop(clock, scheduling, seconds=seconds, rate_hz=loop.rate_hz, late_after_s=loop.late_after_s)


def delays_in_motion(bench: Bench) -> Iterator[Finding]:
    """Measure the delay from a command to the turn of the axes, by servos and encoders.

    Args:
        bench: bench with open servos, and open encoders if it has them. The robot is on a stand.

    Raises:
        Broken, DeviceError: nothing could be measured.
    """
    steering, encoders, wheels = list[float](), list[float](), list[float]()
    if (sensor := bench.devices.get("encoders")) is not None:
        sensor.close()  # discard samples from before this read
        sensor.open()
    with enabled(bench) as start:
        at_loop_rate(bench, 0.3, still(start))
        for number in range(_TIMES):
            way = 1.0 if number % 2 == 0 else -1.0
            turn = ServoSetpoint(np.zeros(4), start.steer_rad + way * 0.5 * _TURN_RAD)
            seen = _watch(bench, turn)
            steering.append(_mean_delay_s(*seen["servos"]))
            if "encoders" in seen:
                encoders.append(_mean_delay_s(*seen["encoders"]))
        at_loop_rate(bench, 0.5, still(start))
        for number in range(_TIMES):
            way = 1.0 if number % 2 == 0 else -1.0
            wheels.append(_rolling_delay_s(bench, start, way * _RATE_RAD_S))
    if encoders:
        yield _agreement(1e3 * float(np.median(steering)), 1e3 * float(np.median(encoders)))
    for device, check, found in (
        ("servos", "command to steering", steering),
        ("encoders", "command to steering", encoders),
        ("servos", "command to wheels", wheels),
    ):
        if found:
            yield _delay(device, check, np.array(found))


def _delay(device: str, check: str, found_s: Array) -> Finding:
    median, spread = 1e3 * float(np.median(found_s)), 1e3 * float(np.ptp(found_s))
    right = _LEAST_S <= 1e-3 * median <= _MOST_S
    return Finding(
        device,
        check,
        "ok" if right else "failure",
        f"{median:.1f} ms (span of {len(found_s)}: {spread:.1f} ms)",
        f"{1e3 * _LEAST_S:g} to {1e3 * _MOST_S:g} ms",
        "" if right else _BUS,
    )


def _agreement(servos_ms: float, encoders_ms: float) -> Finding:
    """Compare the delays of servos and encoders: the later one delays its values, or stamps them too late."""
    apart_ms = abs(servos_ms - encoders_ms)
    right = apart_ms <= 1e3 * _APART_S
    late, other = ("servos", "encoders") if servos_ms > encoders_ms else ("encoders", "servos")
    return Finding(
        late if not right else "servos",
        "servos and encoders agree",
        "ok" if right else "failure",
        f"servos {servos_ms:.1f} ms, encoders {encoders_ms:.1f} ms after the command",
        f"at most {1e3 * _APART_S:g} ms apart",
        "" if right else f"the {late} report it later than the {other}: look for the cause of their delay",
    )


def _watch(bench: Bench, setpoint: ServoSetpoint) -> dict[str, tuple[Array, Array]]:
    """Command once a cycle; return times from the start (s) and mean steering angles (rad), by device."""
    servos, sensor = bench.devices.servos, bench.devices.get("encoders")
    assert servos is not None
    before = fresh(bench)
    rows: dict[str, list[tuple[int, float]]] = {"servos": [], "encoders": []}
    if sensor is not None:
        sensor.read()
    began_ns = next_ns = bench.clock.now_ns()
    rows["servos"].append((began_ns, float(before.steer_rad.mean())))
    for _ in range(round(_LASTS_S * bench.config.loop.rate_hz)):
        servos.command(setpoint)
        rows["servos"] += [(s.stamp.t_ns, float(s.steer_rad.mean())) for s in servos.read() if s.ok]
        if sensor is not None:
            rows["encoders"] += [
                (s.stamp.t_ns, float(s.angle_rad.mean())) for s in sensor.read() if worst(s) is Status.OK
            ]
        next_ns += nanoseconds(1.0 / bench.config.loop.rate_hz)
        bench.clock.sleep_until_ns(next_ns)
    return {
        name: ((np.array([t for t, _ in seen]) - began_ns) / NS_PER_S, np.array([a for _, a in seen]))
        for name, seen in rows.items()
        if len(seen) > 2
    }


def _mean_delay_s(t_s: Array, angle_rad: Array) -> float:
    """Mean delay of a step response, s: the area between step and response, divided by the step.

    Times below 0 are before the step; the last fifth counts as the final value.
    """
    late = t_s > 0.8 * _LASTS_S
    first, last = float(angle_rad[0]), float(angle_rad[late].mean())
    if not abs(last - first) > 0.2 * _TURN_RAD:
        raise Broken(f"the steering turned by {last - first:.3f} rad", f"about {_TURN_RAD:g} rad", _BUS)
    left = 1.0 - (angle_rad - first) / (last - first)
    after = t_s >= 0.0
    t_s, left = np.append(0.0, t_s[after]), np.append(1.0, left[after])
    return float(np.sum(0.5 * (left[1:] + left[:-1]) * np.diff(t_s)))


def _rolling_delay_s(bench: Bench, start: ServoSample, rate_rad_s: float) -> float:
    """Delay of the wheels, s: where the line fitted to their steady rotation meets their angle at rest."""
    servos = bench.devices.servos
    assert servos is not None
    rest = float(at_loop_rate(bench, 0.4, still(start)).drive_rad.mean())
    began_ns = next_ns = bench.clock.now_ns()
    setpoint = ServoSetpoint(np.full(4, rate_rad_s), start.steer_rad.copy())
    rows = list[tuple[float, float]]()
    for _ in range(round(_LASTS_S * bench.config.loop.rate_hz)):
        servos.command(setpoint)
        rows += [
            ((s.stamp.t_ns - began_ns) / NS_PER_S, float(s.drive_rad.mean())) for s in servos.read() if s.ok
        ]
        next_ns += nanoseconds(1.0 / bench.config.loop.rate_hz)
        bench.clock.sleep_until_ns(next_ns)
    steady = np.array([row for row in rows if row[0] > 0.5 * _LASTS_S]).reshape(-1, 2)
    if len(steady) < 3:
        raise Broken(f"{len(steady)} good samples of the wheels", "one a cycle", "check cable and supply")
    rate, offset = np.polyfit(steady[:, 0], steady[:, 1], 1)
    if not abs(rate) > 0.5 * abs(rate_rad_s):
        raise Broken(f"the wheels turn at {rate:.2f} rad/s", f"{rate_rad_s:g} rad/s", _BUS)
    return float((rest - offset) / rate)
