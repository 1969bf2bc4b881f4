"""Contract checks of commanded servos. Wheels turn: the robot is on a stand or on an open floor.

Every check takes a bench whose servos are open, ends with wheels at rest and torque on, and restores the
steering angles.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from hil.bench.bench import Bench
from hil.bench.contract.device_under_test import Broken
from hil.config.servos import ServosConfig
from hil.core.clock import nanoseconds
from hil.core.geometry import Array
from hil.core.signals import DRIVES, SERVOS, STEERS, ServoSample, ServoSetpoint

_PATIENCE_S = 1.0
_TRIES = 5
_RATE_RAD_S = 1.0
_STEP = np.array([0.1, -0.1, 0.1, -0.1])
_RESTS_RAD, _STEERS_RAD, _RATE_OFF_RAD_S = 0.01, 0.03, 0.1
_HORN = "check the horn, the load on the axis and the servo's gains"
_SUPPLY = "check supply, plugs and cable of these servos, and what else draws from the supply"
_VOLTS, _CELSIUS = (9.0, 16.0), (5.0, 80.0)
_HEALTH_S, _SILENT_S = 2.5, 1.5


def pause(bench: Bench, duration_s: float) -> None:
    """Wait without any request to a device."""
    bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(duration_s))


def fresh(bench: Bench) -> ServoSample:
    """The next sample with all eight servos good; single lost or marked reads are no failure."""
    servos = _servos(bench)
    for _ in range(round(_PATIENCE_S * bench.config.loop.rate_hz)):
        (sample,) = servos.read()
        if sample.ok:
            return cast("ServoSample", sample)
        pause(bench, 1.0 / bench.config.loop.rate_hz)
    message = ", ".join(
        f"{n} {s.value}" for n, s in zip(SERVOS, sample.status, strict=True) if s.value != "ok"
    )
    raise Broken(f"no good sample in {_PATIENCE_S:g} s: {message}", "all eight", "check cable and supply")


def at_loop_rate(bench: Bench, duration_s: float, setpoint: ServoSetpoint | None = None) -> ServoSample:
    """Read (and command) at the loop rate for a time without a gap; return the last good sample.

    After a gap of half the bus watchdog's time the wheels may have stopped, so the time restarts.

    Raises:
        Broken: this computer left a gap in each of `_TRIES` tries.
    """
    period_ns, servos = nanoseconds(1.0 / bench.config.loop.rate_hz), _servos(bench)
    longest_ns = max(nanoseconds(_table(bench).watchdog_s) // 2, 2 * period_ns)
    cycles = round(duration_s * bench.config.loop.rate_hz)
    for _ in range(_TRIES):
        next_ns = last_ns = bench.clock.now_ns()
        for _ in range(cycles):
            if setpoint is not None:
                servos.command(setpoint)
            servos.read()
            next_ns += period_ns
            bench.clock.sleep_until_ns(next_ns)
            now_ns = bench.clock.now_ns()
            if now_ns - last_ns > longest_ns:
                break
            last_ns = now_ns
        else:
            return fresh(bench)
    raise Broken(
        f"cycles more than {1e-9 * longest_ns:g} s apart in each of {_TRIES} tries",
        f"{duration_s:g} s at {bench.config.loop.rate_hz:g} Hz without a gap",
        "end other programs on this computer and try again",
    )


@contextmanager
def enabled(bench: Bench) -> Iterator[ServoSample]:
    """Switch torque on and yield the initial angles; always stop the wheels afterwards."""
    servos = _servos(bench)
    servos.enable()
    try:
        yield fresh(bench)
    finally:
        servos.stop()


def still(sample: ServoSample) -> ServoSetpoint:
    """Setpoint: wheels at rest, steering angles of a sample."""
    return ServoSetpoint(np.zeros(4), sample.steer_rad.copy())


def rolling(sample: ServoSample, rate_rad_s: float = _RATE_RAD_S) -> ServoSetpoint:
    """Setpoint: all wheels at one rate, steering angles of a sample."""
    return ServoSetpoint(np.full(4, rate_rad_s), sample.steer_rad.copy())


def enabling_moves_nothing(bench: Bench) -> str:
    """Torque on moves no axis; 0.1 rad is tolerated, as a robot without torque creeps down its wall."""
    before = fresh(bench)
    with enabled(bench) as held:
        _near("turned when torque came on", held.position_rad, before.position_rad, 0.1)
        after = at_loop_rate(bench, 0.5, still(held))
    return _near("turned when held", after.position_rad, held.position_rad, 0.02)


def goals_are_reached(bench: Bench) -> str:
    """Wheel rates and steering angles reach their goals, with the right signs."""
    with enabled(bench) as start:
        turned = ServoSetpoint(5.0 * _STEP, start.steer_rad + _STEP)
        sample = at_loop_rate(bench, 1.5, turned)
        _near("wheel rates", sample.drive_rad_s, turned.drive_velocity_rad_s, _RATE_OFF_RAD_S, "rad/s")
        reported = _near("steering", sample.steer_rad, turned.steer_position_rad, _STEERS_RAD)
        moved = sample.drive_rad - start.drive_rad
        if not np.all(np.sign(moved) == np.sign(turned.drive_velocity_rad_s)):
            raise Broken(f"wheels turned by {np.round(moved, 2)} rad", "the signs of the goals", _HORN)
        back = at_loop_rate(bench, 1.0, still(start))
        _near("steering, back again,", back.steer_rad, start.steer_rad, _STEERS_RAD)
    return reported


def stop_holds(bench: Bench) -> str:
    """After a stop the wheels rest and the steering angles stay."""
    with enabled(bench) as start:
        at_loop_rate(bench, 0.5, rolling(start))
        _servos(bench).stop()
        resting = at_loop_rate(bench, 0.4)
        later = at_loop_rate(bench, 0.4)
        _near("turned after the stop", later.position_rad, resting.position_rad, _RESTS_RAD)
        return _near("steering", later.steer_rad, start.steer_rad, _STEERS_RAD)


def a_forgotten_wheel_stops(bench: Bench) -> str:
    """Without further commands the wheels stop and the robot stays held."""
    with enabled(bench) as start:
        moving = at_loop_rate(bench, 0.5, rolling(start))
        pause(bench, _SILENT_S)
        quiet = fresh(bench)
        later = at_loop_rate(bench, 0.2)
        went_rad = float(np.max(quiet.drive_rad - moving.drive_rad))
        if went_rad >= 0.8:
            raise Broken(
                f"wheels went on for {went_rad:.2f} rad", "less than 0.8 rad", "set servos.watchdog_s"
            )
        _near("turned in silence", later.position_rad, quiet.position_rad, 0.02)
        _near("steering", later.steer_rad, start.steer_rad, _STEERS_RAD)
        return f"after {went_rad:.2f} rad"


def obeys_after_silence(bench: Bench) -> str:
    """Servos without requests for a while keep torque and watchdog, and follow the next goals.

    The driver keeps them alive meanwhile. A computer that is late itself can miss that once, so there are
    `_TRIES` tries.
    """
    with enabled(bench) as start:
        for _ in range(_TRIES):
            pause(bench, 5.0 * _table(bench).watchdog_s)
            trouble = _servos(bench).look_after().trouble
            if not trouble:
                break
            fresh(bench)
        else:
            raise Broken(
                "; ".join(f"{name}: {text}" for name, text in trouble.items()),
                "all servos answer, with torque and an armed watchdog",
                "check supply and cable; on a computer that was late itself, try again when it is idle",
            )
        fresh(bench)
        moving = at_loop_rate(bench, 0.5, rolling(start))
        return _near("wheel rates", moving.drive_rad_s, np.full(4, _RATE_RAD_S), _RATE_OFF_RAD_S, "rad/s")


def goals_beyond_limits_are_clipped(bench: Bench) -> str:
    """A rate goal beyond the limit is clipped to the limit."""
    with enabled(bench) as start:
        sample = at_loop_rate(bench, 0.6, rolling(start, 50.0))
        limit = _table(bench).velocity_limit_rad_s
        slowest, fastest = (float(f(sample.drive_rad_s)) for f in (np.min, np.max))
        if fastest > limit + 0.2 or slowest <= 0.5:
            raise Broken(f"{slowest:.2f} to {fastest:.2f} rad/s", f"up to {limit:g} rad/s", _HORN)
        return f"{fastest:.2f} of {limit:g} rad/s"


def health_is_reported(bench: Bench) -> str:
    """Voltage and temperature are reported at their slow rate, and are plausible."""
    found, servos = list[Any](), _servos(bench)
    for _ in range(round(100.0 * _HEALTH_S)):
        servos.read()
        found += servos.read_health()
        pause(bench, 0.01)
    if not 1 <= len(found) <= 4:
        raise Broken(f"{len(found)} reports in {_HEALTH_S:g} s", "one to four", "check the servo bus")
    volts, celsius = found[-1].voltage_v, found[-1].temperature_c
    message = (
        f"{np.min(volts):.1f} to {np.max(volts):.1f} V, {np.min(celsius):.0f} to {np.max(celsius):.0f} degC"
    )
    if not (_within(volts, _VOLTS) and _within(celsius, _CELSIUS)):
        expected = f"{_VOLTS[0]:g} to {_VOLTS[1]:g} V, {_CELSIUS[0]:g} to {_CELSIUS[1]:g} degC"
        raise Broken(message, expected, "check supply and load of the servos")
    return message


def stop_never_raises(bench: Bench) -> str:
    """`stop` does not raise, not even on a closed port."""
    servos = _servos(bench)
    servos.close()
    servos.stop()
    servos.open()
    return "not on a closed port either"


def without_restart(check: Callable[[Bench], str]) -> Callable[[Bench], str]:
    """Wrap a check so that it also fails if a servo restarts meanwhile.

    The driver configures a restarted servo again, so that the other checks may pass. Drivers without a
    restart counter (`restarts`) report no restarts.
    """

    def checked(bench: Bench) -> str:
        before = dict(_restarts(bench))
        try:
            reported = check(bench)
        except Broken as broken:
            if names := _restarted_since(bench, before):
                found = f"{broken.found}; {names} restarted meanwhile"
                raise Broken(found, broken.expected, _SUPPLY) from None
            raise
        if names := _restarted_since(bench, before):
            raise Broken(f"{names} restarted", "no servo that starts over", _SUPPLY)
        return reported

    return checked


def _restarted_since(bench: Bench, before: Mapping[str, int]) -> str:
    return ", ".join(name for name, count in _restarts(bench).items() if count > before.get(name, 0))


def _restarts(bench: Bench) -> Mapping[str, int]:
    found: Mapping[str, int] = getattr(_servos(bench), "restarts", {})
    return found


def _servos(bench: Bench) -> Any:
    return bench.devices.servos


def _table(bench: Bench) -> ServosConfig:
    table = bench.config.of(ServosConfig)
    assert table is not None
    return table


def _within(values: Array, limits: tuple[float, float]) -> bool:
    return bool(np.all((values > limits[0]) & (values < limits[1])))


def _near(what: str, values: Array, wanted: Array, tolerance: float, unit: str = "rad") -> str:
    """Compare values with goals; raises `Broken` with the names of joints that exceed the tolerance."""
    off = np.abs(values - wanted)
    names = SERVOS if len(off) == 8 else DRIVES if unit == "rad/s" else STEERS
    if not np.all(off <= tolerance):
        message = ", ".join(f"{n} {o:.3f}" for n, o in zip(names, off, strict=True) if not o <= tolerance)
        raise Broken(f"{what}: off by {message} {unit}", f"at most {tolerance:g} {unit}", _HORN)
    return f"off by at most {np.max(off):.3f} {unit}"


_CHECKS: Mapping[str, Callable[[Bench], str]] = {
    "enabling moves nothing": enabling_moves_nothing,
    "goals are reached": goals_are_reached,
    "stop holds": stop_holds,
    "a forgotten wheel stops": a_forgotten_wheel_stops,
    "obeys after silence": obeys_after_silence,
    "goals beyond limits are clipped": goals_beyond_limits_are_clipped,
    "health is reported": health_is_reported,
    "stop never raises": stop_never_raises,
}
IN_MOTION = {promise: without_restart(check) for promise, check in _CHECKS.items()}
"""Checks by the name of the promise, as shown on a page."""
