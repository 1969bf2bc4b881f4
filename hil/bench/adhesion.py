"""Fan and propellers of a bench outside any run: what `hil adhesion` does, by their keepers and devices."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from hil.bench.drivers import make_rig
from hil.bench.settings import adhesion_limits, can_fall, force_wanted_n, thrust_wanted_n
from hil.bench.tilt import tilt_rad
from hil.config.adhesion import AdhesionConfig, MotorConfig
from hil.config.bench import BenchConfig
from hil.config.kept_motor import KeptMotorConfig
from hil.drivers.adhesion.keeper import client
from hil.drivers.adhesion.keeper.client import Status
from hil.drivers.adhesion.keeper.door import keepers
from hil.drivers.adhesion.keeper.spec import Spec
from hil.vocabulary.clock import MonotonicClock, nanoseconds
from hil.vocabulary.errors import ConfigError, DeviceError, UsageError
from hil.vocabulary.port_users import Program, ending, named, running
from hil.vocabulary.signals import Status as SampleStatus
from hil.vocabulary.signals import worst

__all__ = [
    "Spec",
    "Status",
    "described",
    "keeper_command",
    "keeper_spec",
    "keeper_status",
    "kept_specs",
    "other_keepers",
    "seen_off_the_wall",
    "switch_off",
    "switch_on",
]

_STEP_NS = nanoseconds(0.02)
_WATCH_S = 2.0
_NEAR, _STEADY_NS, _TELL_NS = 0.05, nanoseconds(0.5), nanoseconds(1.0)
_LEVEL_RAD = math.radians(15.0)
_NO_FORCE = 0.2
"""Share of what the fan's speed would press with: less of it in the cells means that nothing is sucked at."""
_CELLS_REST_N = 1.0
_TURNS_RPM = 1000.0
"""From here on speed over duty is that of a fan that runs."""
DEVICE = "adhesion"
_TETHERED = "say --tethered once the robot is tethered or off the wall"

Say = Callable[[str], None]


def kept_specs(config: BenchConfig) -> dict[str, Spec]:
    """What is kept running of a bench, by kind: the fan first, and propellers behind VESCs.

    Raises:
        ConfigError: it has neither, or a fan that no other program can reach.
    """
    found = {
        name: Spec(**table.keeper())
        for name, table in config.devices().items()
        if isinstance(table, KeptMotorConfig) and table.backend == "real"
    }
    return found if found and config.of(AdhesionConfig) is None else {DEVICE: keeper_spec(config), **found}


def keeper_spec(config: BenchConfig) -> Spec:
    """What keeps the fan of a bench.

    Raises:
        ConfigError: it has no fan, or one that no other program can reach.
    """
    table = _fan(config)
    if not isinstance(table, MotorConfig):
        raise ConfigError(
            f"{config.name}: a fan without a keeper", expected="one whose controller is on CAN",
            remedy='adhesion.model = "vesc" or "dronecan"',
        )  # fmt: skip
    return Spec(**table.keeper())


def _fan(config: BenchConfig) -> AdhesionConfig:
    table = config.of(AdhesionConfig)
    if table is None:
        raise ConfigError(
            f"{config.name}: no fan", expected="a table [adhesion]", remedy="see docs/hardware.md"
        )
    if table.backend == "emulated":
        raise ConfigError(
            f"{config.name}: its fan is emulated, and is gone with the program that emulates it",
            expected='adhesion.backend = "real"',
            remedy="serve it with `hil emulate` and write its endpoint into a bench file",
        )
    return table


def keeper_status(spec: Spec) -> Status | None:
    """What a keeper says; None where there is none. Raises `DeviceError`."""
    connection = client.connect(spec)
    if connection is None:
        return None
    with connection:
        return client.ask(connection, {"do": "status"}, spec)


def other_keepers(specs: Collection[Spec]) -> list[str]:
    """Names of fans and propellers on the buses of these that have a keeper and are not among them."""
    named, buses = {spec.name for spec in specs}, {spec.bus for spec in specs}
    return [name for name in keepers() if name not in named and name.rpartition(", controller ")[0] in buses]


def switch_on(
    config: BenchConfig,
    *,
    force_n: float | None,
    duty: float | None,
    wait_s: float,
    say: Say,
    tethered: bool = False,
) -> float:
    """Start the fan, or give one that runs another set-point, and wait until it is reached.

    Args:
        config: of the bench; its fan is opened, and IMU and load cells where a robot might fall.
        force_n: what to ask for; what the bench wants on its wall when None.
        duty: asked for in place of a force.
        wait_s: how long it may take.
        say: told how far it is.
        tethered: the robot is tethered or off the wall: somebody has looked.

    Returns:
        The force that the fan's speed gives, N. The fan goes on, whatever ends this.

    Raises:
        ConfigError, UsageError, DeviceError: it cannot be asked for, or is not reached; a bench commands the
            fan now; or it is too little for a robot that may hang by it, as `seen_off_the_wall` says.
    """
    table, clock = _fan(config), MonotonicClock()
    wanted_n = force_wanted_n(config) if force_n is None else force_n
    if isinstance(table, MotorConfig):
        _must_be_free(keeper_spec(config))
    fan: Any = make_rig(config, clock, {}).get(DEVICE)
    if not tethered:
        fan.open()
        with contextlib.closing(fan):
            now = _first_report(fan, clock)
        asked_n = wanted_n if duty is None else _duty_n(table, duty, now)
        _must_be_enough(config, table.force_at_n(now.speed_rpm), asked_n)
    fan.open()
    with contextlib.closing(fan):
        _first_report(fan, clock)  # a fan that runs goes on from there
        if duty is None:
            fan.set_force_n(wanted_n)
        else:
            fan.set_duty(duty)
        near_ns, told_ns, newest = None, 0, None
        end_ns = clock.now_ns() + nanoseconds(wait_s)
        while (now_ns := clock.now_ns()) < end_ns:
            newest = (*fan.read()[-1:], newest)[0]
            if newest is not None:
                is_n = table.force_at_n(newest.speed_rpm)
                off = is_n / wanted_n - 1.0 if duty is None else newest.duty / duty - 1.0
                near_ns = (near_ns or now_ns) if abs(off) <= _NEAR else None
                if near_ns is not None and now_ns - near_ns >= _STEADY_NS:
                    return is_n
                if now_ns - told_ns > _TELL_NS:
                    told_ns = now_ns
                    say(f"{newest.speed_rpm:.0f} 1/min, good for {is_n:.1f} N")
            clock.sleep_until_ns(now_ns + _STEP_NS)
        raise _not_reached(newest, f"{wanted_n:g} N" if duty is None else f"duty {duty:g}", wait_s)


def _must_be_free(spec: Spec) -> None:
    """Refuse a fan that another program commands: that one would ask for its own set-point at once.

    Raises:
        UsageError: a bench, or another `hil adhesion on`, has asked its keeper for a set-point and goes on.
    """
    setters = set((keeper_status(spec) or {}).get("set_by", ())) - {os.getpid()}
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
    """A good sample of the fan, as soon as there is one; raises `DeviceError` where none comes."""
    end_ns = clock.now_ns() + nanoseconds(_WATCH_S)
    while clock.now_ns() < end_ns:
        good = [sample for sample in fan.read() if worst(sample) is SampleStatus.OK]
        if good:
            return good[-1]
        clock.sleep_until_ns(clock.now_ns() + _STEP_NS)
    raise DeviceError(
        DEVICE, f"no usable report of its speed for {_WATCH_S:g} s: nothing was changed",
        expected="how fast the fan turns, before it is given another set-point",
        remedy="`hil doctor` examines its controller",
    )  # fmt: skip


def _must_be_enough(config: BenchConfig, is_n: float, asked_n: float) -> None:
    """Refuse a set-point that lets a robot fall that may hang by its fan: less than now, or than it needs.

    Args:
        config: of the bench.
        is_n: what the fan gives now, N.
        asked_n: what it is to give, N; NaN where nobody can tell.

    Raises:
        UsageError: IMU and load cells do not say that the robot is off the wall.
        DeviceError: one of them cannot be asked.
    """
    least_n, limits = 0.0, adhesion_limits(config)
    if limits is not None and can_fall(config):
        least_n = limits.limit_n(thrust_wanted_n(config), config.environment.start_pose[2])
    if asked_n >= max((1.0 - _NEAR) * is_n, least_n):
        return
    least = f"; {least_n:.1f} N are the least on this surface" if least_n else ""
    try:
        seen_off_the_wall(config)
    except UsageError as error:
        raise UsageError(
            f"the fan stays at {is_n:.1f} N, it is not set to {asked_n:.1f} N{least}: {error.message}",
            expected=error.expected, remedy=error.remedy,
        ) from None  # fmt: skip


def _duty_n(table: AdhesionConfig, duty: float, now: Any) -> float:
    """Force that a duty gives, N: by how the fan runs now, else by its ratings; NaN where nothing tells."""
    if now.duty > 0.0 and now.speed_rpm > _TURNS_RPM:
        return table.force_at_n(now.speed_rpm * duty / now.duty)
    if not isinstance(table, MotorConfig):
        return math.nan
    input_v = now.input_v if math.isfinite(now.input_v) else table.rated_input_v
    return table.force_at_n(table.DROOP * table.rpm_per_v * input_v * duty)


def _not_reached(newest: Any, wanted: str, wait_s: float) -> DeviceError:
    found = "no report" if newest is None else f"{newest.speed_rpm:.0f} 1/min, duty {newest.duty:.2f}"
    trouble = f" ({newest.trouble})" if newest is not None and newest.trouble else ""
    return DeviceError(
        DEVICE, f"not steady at the set-point within {wait_s:g} s: {found}{trouble}", expected=wanted,
        remedy="it goes on as far as it can; look at battery and temperature (`hil adhesion status`)",
    )  # fmt: skip


def switch_off(spec: Spec, confirmed_by: str, *, say: Say) -> Status | None:
    """Let a fan or propellers come to rest along the ramp and wait for it; None where they have no keeper.

    Args:
        spec: what is kept.
        confirmed_by: why nothing hangs by it.
        say: told how far it is.

    Raises:
        UsageError: somebody has asked for the force again meanwhile.
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
                raise UsageError(f"somebody has asked for {spec.noun} again", remedy="`hil adhesion status`")
        return status


def seen_off_the_wall(config: BenchConfig) -> str:
    """What shows that the robot does not hang by its fan: it lies level, and nothing is pressed.

    Both have to say so, because either may lie.

    Raises:
        UsageError: something says that it may hang, or nobody can see.
    """
    table = _fan(config)
    rig, clock = make_rig(config, MonotonicClock(), {}), MonotonicClock()
    seen: dict[str, list[Any]] = {}
    for name in ("imu", "load_cells", DEVICE):
        device = rig.get(name)
        if device is None or config.devices()[name].backend == "emulated":
            raise UsageError(
                f"{config.name}: no {name} of the robot to see whether it is off the wall",
                expected="imu, load_cells and adhesion, all real", remedy=_TETHERED,
            )  # fmt: skip
        device.open()
        try:
            seen[name] = _watched(device, clock)
        finally:
            device.close()
    tilted_rad = tilt_rad(config, seen["imu"])
    blows_n = max((table.force_at_n(s.speed_rpm) for s in seen[DEVICE]), default=math.nan)
    limit_n = max(_NO_FORCE * blows_n, _CELLS_REST_N)
    force_n = max((float(np.sum(s.force_n)) for s in seen["load_cells"]), default=math.nan)
    told = f"tilted by {math.degrees(tilted_rad):.0f} deg, load cells {force_n:.1f} N"
    if not (tilted_rad <= _LEVEL_RAD and abs(force_n) <= limit_n):
        raise UsageError(
            f"the robot may hang by its fan: {told}",
            expected=f"at most {math.degrees(_LEVEL_RAD):.0f} deg and {limit_n:.1f} N", remedy=_TETHERED,
        )  # fmt: skip
    return f"seen off the wall: {told}"


def _watched(device: Any, clock: MonotonicClock) -> list[Any]:
    """Good samples of a while."""
    samples: list[Any] = []
    end_ns = clock.now_ns() + nanoseconds(_WATCH_S)
    while clock.now_ns() < end_ns:
        samples += device.read()
        clock.sleep_until_ns(clock.now_ns() + _STEP_NS)
    return [s for s in samples if worst(s) is SampleStatus.OK]


def described(status: Mapping[str, Any]) -> str:
    """One line about a kept fan."""
    sent, report = status["sent"], status["report"]
    parts = [status["state"] + (f" at {sent[0]} {sent[1]:.3g}" if sent else "")]
    units = (
        ("erpm", "electrical 1/min", 0),
        ("current_a", "A", 1),
        ("input_v", "V", 1),
        ("fet_c", "degC", 0),
    )
    parts += [f"{report[name]:.{digits}f} {unit}" for name, unit, digits in units if name in report]
    if status["report_age_s"] is None or status["report_age_s"] > 1.0:
        parts.append("its controller is silent")
    if sent:
        parts.append(f"longest gap between commands {1e3 * status['worst_gap_s']:.0f} ms")
    if status["bus_error"]:
        parts.append(f"CAN: {status['bus_error']}: it stops {status['timeout_s']:g} s after the last command")
    return ", ".join(parts)


def keeper_command(spec: Spec) -> list[str]:
    """The command line of a keeper that stays in the foreground."""
    return [*client.KEEPER, spec.to_json(), "--stay"]
