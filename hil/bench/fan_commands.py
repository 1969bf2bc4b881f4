"""Switches a bench's fan and propellers outside any run, for `hil adhesion`."""

import contextlib
import os
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from hil.bench.device_set_from_config import make_device_set
from hil.bench.fan_interlock import DEVICE, STEP_NS, WATCH_S, duty_n, fan_of, forces_now_n, must_be_enough
from hil.bench.fan_start_check import FanStartCheck, contradicted
from hil.bench.loop_settings import force_wanted_n
from hil.config.adhesion import AdhesionConfig, MotorConfig
from hil.config.bench import BenchConfig
from hil.config.can_motor import DaemonMotorConfig
from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.errors import ConfigError, DeviceError, UsageError
from hil.core.signals import AdhesionSample, worst
from hil.core.signals import Status as SampleStatus
from hil.fan_daemon import client
from hil.fan_daemon.client import Status, of_whom
from hil.fan_daemon.fan_control import RELEASE, SetPoint
from hil.fan_daemon.server import is_on, running_daemons, socket_name
from hil.fan_daemon.spec import Spec
from hil.support.port_users import Program, ending, named, running

__all__ = [
    "Spec",
    "Status",
    "daemon_command",
    "daemon_spec",
    "daemon_specs",
    "daemon_status",
    "described",
    "of_whom",
    "other_daemons",
    "switch_off",
    "switch_on",
]

_NEAR, _STEADY_NS, _SAY_NS = 0.05, nanoseconds(0.5), nanoseconds(1.0)

Say = Callable[[str], None]


def daemon_specs(config: BenchConfig) -> dict[str, Spec]:
    """Specs of all daemons of a bench, by kind: first the fan, then propellers behind VESCs.

    Raises:
        ConfigError: the bench has neither, or no other program can reach its fan.
    """
    found = {
        name: Spec(**table.daemon_spec())
        for name, table in config.devices().items()
        if isinstance(table, DaemonMotorConfig) and table.backend == "real"
    }
    return found if found and config.of(AdhesionConfig) is None else {DEVICE: daemon_spec(config), **found}


def daemon_spec(config: BenchConfig) -> Spec:
    """Spec of the daemon of a bench's fan.

    Raises:
        ConfigError: the bench has no fan, or no other program can reach it.
    """
    table = fan_of(config)
    if not isinstance(table, MotorConfig):
        raise ConfigError(
            f"{config.name}: a fan without a daemon",
            expected="one whose controller is on CAN",
            remedy='adhesion.model = "vesc" or "dronecan"',
        )
    return Spec(**table.daemon_spec())


def daemon_status(spec: Spec) -> Status | None:
    """Status of a running daemon; None if none runs. Raises `DeviceError`."""
    connection = client.connect(spec)
    if connection is None:
        return None
    with connection:
        return client.ask(connection, {"do": "status"}, spec)


def other_daemons(specs: Collection[Spec]) -> list[str]:
    """Names of other fans and propellers with a daemon on the same buses as `specs`."""
    own = {socket_name(spec) for spec in specs}
    others = [name for name in running_daemons() if name not in own]
    return [name for name in others if any(is_on(name, spec.bus) for spec in specs)]


def switch_on(
    config: BenchConfig,
    *,
    force_n: float | None,
    duty: float | None,
    wait_s: float,
    say: Say,
    tethered: bool = False,
) -> float:
    """Start the fan or change its set-point, and wait until the set-point is reached.

    Args:
        config: the bench configuration; opens its fan, and IMU and load cells where a robot might fall.
        force_n: force set-point, N; the bench's working force on its wall when None.
        duty: set-point in place of a force.
        wait_s: time limit, s.
        say: function that receives a line of progress each second.
        tethered: True if the operator has confirmed that the robot is tethered or off the wall.

    Returns:
        The force by the fan's speed, N, with which load cells, duty and voltage agree as far as they are
        there. The fan keeps running, whatever ends this call.

    Raises:
        ConfigError, UsageError, DeviceError: the set-point is invalid or not reached; a bench commands the
        fan now; the force is too small for a robot that may hang by it (`seen_off_the_wall`); or its
        measurements contradict each other, and the fan runs again as before.
    """
    table, clock = fan_of(config), MonotonicClock()
    wanted_n = force_wanted_n(config) if force_n is None else force_n
    known = isinstance(table, MotorConfig)
    if known:
        _must_be_free(daemon_spec(config))
    fan: Any = make_device_set(config, clock, {}).get(DEVICE)
    if not tethered:  # close it again: it would not be commanded while the others are read
        fan.open()
        with contextlib.closing(fan):
            now = _first_report(fan, clock)
        asked_n = wanted_n if duty is None else duty_n(table, duty, now)
        must_be_enough(config, max(forces_now_n(table, now)), asked_n)
    before = (daemon_status(daemon_spec(config)) or {}).get("target") if known else None
    fan.open()
    with contextlib.closing(fan):
        _first_report(fan, clock)  # a running fan starts from there
        if duty is None:
            fan.set_force_n(wanted_n)
        else:
            fan.set_duty(duty)

        def off(sample: AdhesionSample) -> float:
            if duty is None:
                return float(table.force_at_n(sample.speed_rpm) / wanted_n - 1.0)
            return sample.duty / duty - 1.0

        judge, wanted = FanStartCheck(config, table), f"{wanted_n:g} N" if duty is None else f"duty {duty:g}"
        is_n, wrong = _reach(fan, judge, off, clock, wait_s, wanted, say)
    if wrong:  # the fan is closed: none of its own requests can come after this one
        _take_back(config, before, known)
        raise contradicted(wrong)
    return is_n


def _reach(
    fan: Any,
    judge: FanStartCheck,
    off: Callable[[AdhesionSample], float],
    clock: MonotonicClock,
    wait_s: float,
    wanted: str,
    say: Say,
) -> tuple[float, str]:
    """Wait until a fan is steady at its set-point.

    Args:
        fan: the open fan.
        judge: check of its reports.
        off: relative deviation of a report from the set-point.
        clock: the host's clock.
        wait_s: time limit, s.
        wanted: the set-point in words.
        say: function that receives a line of progress each second.

    Returns:
        Force by the speed, N, and the contradiction between the measurements, empty for none.

    Raises:
        DeviceError: the set-point is not reached in time.
    """
    near_ns, said_ns, newest = None, 0, None
    end_ns = clock.now_ns() + nanoseconds(wait_s)
    while (now_ns := clock.now_ns()) < end_ns:
        for sample in fan.read():
            newest = sample
            if wrong := judge.contradiction(sample):
                return judge.force_n(sample), wrong
        if newest is not None:
            is_n = judge.force_n(newest)
            near_ns = (near_ns or now_ns) if abs(off(newest)) <= _NEAR else None
            if near_ns is not None and now_ns - near_ns >= _STEADY_NS:
                return is_n, judge.by_cells(is_n, clock)
            if now_ns - said_ns > _SAY_NS:
                said_ns = now_ns
                say(f"{newest.speed_rpm:.0f} 1/min, good for {is_n:.1f} N")
        clock.sleep_until_ns(now_ns + STEP_NS)
    raise _not_reached(newest, wanted, wait_s)


def _take_back(config: BenchConfig, before: Any, known: bool) -> None:
    """Go back to the set-point of before, not to where its ramp then was; a fan without one comes to rest."""
    connection = client.connect(daemon_spec(config)) if known else None
    if connection is None:
        return
    why = "it was at rest before, and its measurements contradict each other"
    point = RELEASE if before is None else SetPoint(*before)
    request = client.set_request(point) if point.value > 0.0 else client.off_request(why)
    with connection:
        client.ask(connection, request, daemon_spec(config))


def _must_be_free(spec: Spec) -> None:
    """Refuse a fan that another program commands: that program would send its own set-point at once.

    Raises:
        UsageError: a bench, or another `hil adhesion on`, is sending set-points to its daemon.
    """
    setters = set((daemon_status(spec) or {}).get("set_by", ())) - {os.getpid()}
    if not setters:
        return
    names = {program.pid: program.name for program in running()}
    others = [Program(pid, names.get(pid, "a program")) for pid in sorted(setters)]
    raise UsageError(
        f"{spec.name}: {named(others)} commands the fan now, and would go on with its own set-point",
        expected="a fan that no running bench commands",
        remedy=f"end that program first{ending(others)}; the fan goes on meanwhile",
    )


def _first_report(fan: Any, clock: MonotonicClock) -> Any:
    """Wait for the first good sample of the fan. Raises `DeviceError` if none comes."""
    end_ns = clock.now_ns() + nanoseconds(WATCH_S)
    while clock.now_ns() < end_ns:
        good = [sample for sample in fan.read() if worst(sample) is SampleStatus.OK]
        if good:
            return good[-1]
        clock.sleep_until_ns(clock.now_ns() + STEP_NS)
    raise DeviceError(
        DEVICE,
        f"no usable report of its speed for {WATCH_S:g} s: nothing was changed",
        expected="how fast the fan turns, before it is given another set-point",
        remedy="`hil doctor` examines its controller",
    )


def _not_reached(newest: Any, wanted: str, wait_s: float) -> DeviceError:
    found = "no report" if newest is None else f"{newest.speed_rpm:.0f} 1/min, duty {newest.duty:.2f}"
    trouble = f" ({newest.trouble})" if newest is not None and newest.trouble else ""
    return DeviceError(
        DEVICE,
        f"not steady at the set-point within {wait_s:g} s: {found}{trouble}",
        expected=wanted,
        remedy="it goes on as far as it can; look at battery and temperature (`hil adhesion status`)",
    )


def switch_off(spec: Spec, confirmed_by: str, *, say: Say) -> Status | None:
    """Stop a fan or propellers along the ramp and wait for rest; None where they have no daemon.

    Args:
        spec: the fan or propellers.
        confirmed_by: evidence that the robot does not hang by it.
        say: function that receives a line of progress each half second.

    Raises:
        UsageError: another program has requested the force again meanwhile.
    """
    connection = client.connect(spec)
    if connection is None:
        return None
    with connection:
        status = client.ask(connection, client.off_request(confirmed_by), spec)
        while status["state"] != "idle":
            say(f"{status['sent'][0]} {status['sent'][1]:.2f}")
            time.sleep(0.5)
            status = client.ask(connection, {"do": "status"}, spec)
            if status["state"] == "keeping":
                raise UsageError(
                    f"another program has asked for {spec.noun} again", remedy="`hil adhesion status`"
                )
        return status


def described(status: Mapping[str, Any], spec: Spec) -> str:
    """One line on the state of a fan or propellers, from their daemon's status."""
    sent, report = status["sent"], status["report"]
    parts = [status["state"] + (f" at {sent[0]} {sent[1]:.3g}" if sent else "")]
    units = (
        ("erpm", "1/min" if spec.protocol == "dronecan" else "electrical 1/min", 0),
        ("current_a", "A", 1),
        ("input_v", "V", 1),
        ("fet_c", "degC", 0),
    )
    parts += [f"{report[name]:.{digits}f} {unit}" for name, unit, digits in units if name in report]
    if status["report_age_s"] is None or status["report_age_s"] > 1.0:
        parts.append("its controller is silent")
    if sent:
        parts.append(f"longest gap between commands {1e3 * status['worst_gap_s']:.0f} ms")
    parts += [status["sag"]] * bool(status.get("sag"))
    if status["bus_error"]:
        parts.append(f"CAN: {status['bus_error']}: it stops {status['timeout_s']:g} s after the last command")
    return ", ".join(parts)


def daemon_command(spec: Spec) -> list[str]:
    """The command line of a daemon that stays in the foreground."""
    return [*client.DAEMON, spec.to_json(), "--stay"]
