"""Refuses to lower the fan's force while the robot may hang by it, by IMU and load cells."""

import contextlib
import math
from typing import Any

import numpy as np

from hil.bench.device_set_from_config import make_device_set
from hil.bench.hold.tilt_check import tilt_rad
from hil.bench.loop_settings import adhesion_limits, can_fall, thrust_wanted_n
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.errors import ConfigError, UsageError
from hil.core.signals import Status, worst
from hil.loop.checks.adhesion_limits import reading
from hil.robot.motor_cross_checks import Reading, forces_n, speed_by_voltage_rpm

DEVICE = "adhesion"
WATCH_S, STEP_NS = 2.0, nanoseconds(0.02)
"""Duration and period of reading a device outside any run."""
_AS_NOW = 0.95
"""Share of the present force from which on a set-point does not count as lowering it."""
_LEVEL_RAD = math.radians(15.0)
_NO_FORCE = 0.2
"""Share of the force by the fan's speed; less at the load cells means that there is no suction."""
_CELLS_REST_N = 1.0
_TURNS_RPM = 1000.0
"""Above this speed the fan runs, and speed over duty is valid."""
_TETHERED = "say --tethered once the robot is tethered or off the wall"


def fan_of(config: BenchConfig) -> AdhesionConfig:
    """Table of the real fan of a bench.

    Raises:
        ConfigError: the bench has no fan, or an emulated one.
    """
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


def must_be_enough(config: BenchConfig, is_n: float, asked_n: float) -> None:
    """Refuse a set-point below the present or needed force while the robot may hang by its fan.

    Args:
        config: the bench configuration.
        is_n: present force of the fan, N.
        asked_n: requested force, N; NaN if unknown.

    Raises:
        UsageError: IMU and load cells do not show that the robot is off the wall.
        DeviceError: one of them cannot be read.
    """
    least_n, limits = 0.0, adhesion_limits(config)
    if limits is not None and can_fall(config):
        least_n = limits.limit_n(thrust_wanted_n(config), config.environment.start_pose[2])
    if asked_n >= max(_AS_NOW * is_n, least_n):
        return
    least = f"; {least_n:.1f} N are the least on this surface" if least_n else ""
    try:
        seen_off_the_wall(config)
    except UsageError as error:
        raise UsageError(
            f"the fan stays at {is_n:.1f} N, it is not set to {asked_n:.1f} N{least}: {error.message}",
            expected=error.expected,
            remedy=error.remedy,
        ) from None


def duty_n(table: AdhesionConfig, duty: float, now: Any) -> float:
    """Force at a duty, N, the smaller of that by the present speed and by the ratings; NaN without both."""
    ratings = table.ratings()
    input_v = now.input_v if math.isfinite(now.input_v) else table.rated_input_v
    by_voltage_n = ratings.force_at_n(speed_by_voltage_rpm(ratings, Reading(math.nan, duty, input_v)))
    if not (now.duty > 0.0 and now.speed_rpm > _TURNS_RPM):
        return by_voltage_n
    by_speed_n = table.force_at_n(now.speed_rpm * duty / now.duty)
    return by_speed_n if math.isnan(by_voltage_n) else min(by_speed_n, by_voltage_n)


def forces_now_n(table: AdhesionConfig, now: Any) -> list[float]:
    """Present force of the fan by each measurement of its controller, N."""
    return list(forces_n(table.ratings(), reading(now)).values()) or [0.0]


def seen_off_the_wall(config: BenchConfig) -> str:
    """Measurements that show that the robot does not hang by its fan: level, and no pressing force.

    IMU and load cells must both show it, because either may be wrong.

    Raises:
        UsageError: a sensor shows that it may hang, or no sensor can measure it.
    """
    table = fan_of(config)
    devices, clock = make_device_set(config, MonotonicClock(), {}), MonotonicClock()
    seen: dict[str, list[Any]] = {}
    for name in ("imu", "load_cells", DEVICE):
        device = devices.get(name)
        if device is None or config.devices()[name].backend == "emulated":
            raise UsageError(
                f"{config.name}: no {name} of the robot to see whether it is off the wall",
                expected="imu, load_cells and adhesion, all real",
                remedy=_TETHERED,
            )
        device.open()
        with contextlib.closing(device):
            seen[name] = watched(device, clock)
    tilted_rad = tilt_rad(config, seen["imu"])
    blows_n = min((min(forces_now_n(table, s)) for s in seen[DEVICE]), default=math.nan)
    limit_n = max(_NO_FORCE * blows_n, _CELLS_REST_N)
    zero_n = 0.0 if (cells := config.of(LoadCellsConfig)) is None else sum(cells.zero_n)
    force_n = max((float(np.sum(s.force_n)) for s in seen["load_cells"]), default=math.nan) - zero_n
    message = f"tilted by {math.degrees(tilted_rad):.0f} deg, load cells {force_n:.1f} N"
    if not (tilted_rad <= _LEVEL_RAD and abs(force_n) <= limit_n):
        raise UsageError(
            f"the robot may hang by its fan: {message}",
            expected=f"at most {math.degrees(_LEVEL_RAD):.0f} deg and {limit_n:.1f} N",
            remedy=_TETHERED,
        )
    return f"seen off the wall: {message}"


def watched(device: Any, clock: MonotonicClock) -> list[Any]:
    """Good samples of a device during `WATCH_S`."""
    samples: list[Any] = []
    end_ns = clock.now_ns() + nanoseconds(WATCH_S)
    while clock.now_ns() < end_ns:
        samples += device.read()
        clock.sleep_until_ns(clock.now_ns() + STEP_NS)
    return [s for s in samples if worst(s) is Status.OK]
