"""Checks values of a bench file across its tables: those that contradict each other, or the wall."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import TYPE_CHECKING

from hil.config.adhesion import AdhesionConfig
from hil.config.can_bus import CanConfig, can_conflicts
from hil.config.device import DeviceConfig
from hil.config.environment import SURFACES
from hil.config.field_types import TOP_WHEEL_RATE_RAD_S
from hil.config.load_cells import LoadCellsConfig
from hil.config.servo_models import DEFAULT_MODEL, servo_model
from hil.config.servos import ServosConfig
from hil.config.tracker import T265Config
from hil.core.geometry import wrap
from hil.core.registry import added, base_of, further
from hil.core.signals import WHEELS

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig

WALL_WATCHDOG_S = 0.1
_LEAST_ADHESION_M_S2 = 1.0
_CYCLES_PER_WATCHDOG = 2.0
_SAME = 1.0 + 1e-6

Problem = tuple[str, str]


def contradictions(config: BenchConfig) -> Iterator[Problem]:
    """Dotted path and text of every contradiction in a configuration whose tables are right by themselves."""
    yield from _of_motion(config)
    yield from _of_servos(config)
    yield from _of_the_camera(config)
    yield from _of_the_load_cells(config)
    yield from _of_the_environment(config)
    yield from _of_the_emulation(config)
    yield from _of_imperfections(config)
    yield from can_conflicts(config.devices())
    yield from _of_ports(config.devices())
    if config.environment.on_wall:
        yield from _of_a_wall(config)


def _of_the_environment(config: BenchConfig) -> Iterator[Problem]:
    environment = config.environment
    if environment.surface == "floor" and environment.on_wall:
        yield (
            "environment.surface",
            f"'floor' with tilt_rad = {environment.tilt_rad:g}: nothing holds a robot on a steep floor; a "
            "floor has tilt_rad = 0, a wall is melamine, concrete, ...",
        )
    for k, (axis, area) in enumerate((("x", environment.x_range_m), ("y", environment.y_range_m))):
        at_m = environment.start_pose[k]
        if config.placed and area is not None and not area[0] <= at_m <= area[1]:
            yield (
                "environment.start_pose",
                f"{axis} = {at_m:g} m is outside {axis}_range_m = [{area[0]:g}, {area[1]:g}]",
            )
    if environment.surface not in SURFACES and config.emulated():
        yield (
            "environment.surface",
            f"{environment.surface!r} cannot be emulated, only " + ", ".join(SURFACES),
        )


def _of_the_emulation(config: BenchConfig) -> Iterator[Problem]:
    emulation = config.emulation
    if emulation.plant == "mujoco":
        if emulation.replay is not None:
            yield "emulation.plant", "'mujoco' simulates a robot, emulation.replay repeats one; leave one out"
        return
    for name in ("contact", "mjcf"):
        if (value := getattr(emulation, name)) is not None:
            yield (
                f"emulation.{name}",
                f"{value!r} is of the plant 'mujoco'; add plant = 'mujoco' or remove it",
            )


def _of_imperfections(config: BenchConfig) -> Iterator[Problem]:
    present = config.devices()
    for kind in added():
        if kind.name not in present and config.imperfections(kind.name):
            others = [f"emulation.{name}" for name in present if base_of(name) == kind.name]
            instead = f"; its devices have {', '.join(others)}" if others else ""
            yield f"emulation.{kind.name}", f"the bench has no [{kind.name}] that could be emulated{instead}"


def _of_ports(devices: Mapping[str, DeviceConfig]) -> Iterator[Problem]:
    """Serial ports that two devices of the file share: each would read the bytes of the other."""
    places = [(name, one, *_port(one)) for name, one in devices.items() if one.backend == "real"]
    for (name, one, key, place), (rival, other, their_key, theirs) in combinations(places, 2):
        can = isinstance(one, CanConfig) and isinstance(other, CanConfig)
        shared = _model(other) in one.SHARES_PORT_WITH or _model(one) in other.SHARES_PORT_WITH
        if place and place == theirs and not can and not shared:
            yield (
                f"{rival}.{their_key}",
                f"{getattr(other, their_key)!r} is the port of {name}.{key} = {getattr(one, key)!r}, too: "
                "each device has a port of its own; correct one of them (`hil discover` lists ports)",
            )


def _port(device: DeviceConfig) -> tuple[str, str]:
    """Key that names the serial port of a device, and which one it is; empty where it has none of its own.

    A CAN adapter may be one, too (slcand, `/dev/ttyACM0@115200`).
    """
    key = "channel" if isinstance(device, CanConfig) else "port"
    given = getattr(device, key, "")
    if not isinstance(given, str) or not given or given.lower().startswith("loop://"):
        return key, ""
    if isinstance(device, CanConfig):
        given = given.partition("@")[0]
    return key, given if "://" in given else os.path.realpath(given)


def _model(device: DeviceConfig) -> str:
    return str(getattr(device, "model", ""))


def _of_motion(config: BenchConfig) -> Iterator[Problem]:
    control, safety = config.control, config.safety
    fastest_m_s = TOP_WHEEL_RATE_RAD_S * max(config.robot.wheel_radius_m)
    if control.wheel_speed_m_s > fastest_m_s * _SAME:
        yield (
            "control.wheel_speed_m_s",
            f"{control.wheel_speed_m_s:g} m/s is beyond the {fastest_m_s:.3g} m/s of the "
            "largest wheel (robot.wheel_radius_m) at "
            f"{TOP_WHEEL_RATE_RAD_S:g} rad/s",
        )
    if control.steering_limit_rad > safety.steering_limit_rad * _SAME:
        yield (
            "control.steering_limit_rad",
            f"{control.steering_limit_rad:g} rad is beyond safety.steering_limit_rad = "
            f"{safety.steering_limit_rad:g}: the supervisor would stop the robot there",
        )


def _of_the_camera(config: BenchConfig) -> Iterator[Problem]:
    camera = config.of(T265Config)
    if camera is not None and camera.wheel_odometry and config.of(ServosConfig) is None:
        yield (
            "tracker.wheel_odometry",
            "the bench has no [servos] that would give the camera wheel speeds; add them, or leave it out",
        )
    devices = config.devices()
    for name in further(devices):
        if getattr(devices[name], "wheel_odometry", False):
            yield f"{name}.wheel_odometry", "only the camera [tracker] gets wheel speeds; leave it out here"


def _of_the_load_cells(config: BenchConfig) -> Iterator[Problem]:
    cells = config.of(LoadCellsConfig)
    if cells is not None and max(map(abs, cells.zero_n)) > (most_n := 0.5 * cells.largest_n):
        yield (
            "load_cells.zero_n",
            f"[{cells.zero_n[0]:g}, {cells.zero_n[1]:g}] N while nothing presses: at most half of the range "
            f"(largest_n = {cells.largest_n:g}), {most_n:g} N, or nothing is left to measure with",
        )


def _of_servos(config: BenchConfig) -> Iterator[Problem]:
    servos, safety = config.of(ServosConfig), config.safety
    if servos is None:
        return
    if (asked := safety.wheel_rate_limit_rad_s) > (most := servos.velocity_limit_rad_s) * _SAME:
        yield (
            "safety.wheel_rate_limit_rad_s",
            f"{asked:g} is beyond servos.velocity_limit_rad_s = {most:g}, to which goals would be clipped",
        )
    zeros_rad, widest = config.alignment.steer_zero_rad, servos.steer_limit_rad
    if safety.steering_limit_rad + (zero := max(map(abs, zeros_rad))) > widest * _SAME:
        wheel = WHEELS[list(map(abs, zeros_rad)).index(zero)]
        at = f" about the servo's centre, less {wheel}'s zero of {zero:g} (alignment.steer_zero_rad)" * (
            zero > 0
        )
        yield (
            "safety.steering_limit_rad",
            f"{safety.steering_limit_rad:g} is beyond what the servos can reach: servos.steer_limit_rad = "
            f"{widest:g}{at}, which leaves {widest - zero:.4g}; mount the horn nearer to the servo's centre, "
            "raise servos.steer_limit_rad, or lower safety.steering_limit_rad and control.steering_limit_rad",
        )
    model = servo_model(servos.model_number or DEFAULT_MODEL)
    low_v, high_v = model.pack_v
    if not low_v <= config.robot.supply_v <= high_v:
        yield (
            "robot.supply_v",
            f"{config.robot.supply_v:g} V is not for {model.name} servos (servos.model_number), which take "
            f"{low_v:g} to {high_v:g} V; {model.recommended_v:g} V is recommended",
        )
    if servos.watchdog_s and config.loop.rate_hz * servos.watchdog_s < _CYCLES_PER_WATCHDOG:
        yield (
            "loop.rate_hz",
            f"at {config.loop.rate_hz:g} Hz the bus watchdog (servos.watchdog_s = {servos.watchdog_s:g}) "
            f"would trip between cycles; {_CYCLES_PER_WATCHDOG / servos.watchdog_s:g} Hz or more are needed",
        )


def _of_a_wall(config: BenchConfig) -> Iterator[Problem]:
    servos, safety = config.of(ServosConfig), config.safety
    if servos is not None and not 0.0 < servos.watchdog_s <= WALL_WATCHDOG_S * _SAME:
        message = f"for {servos.watchdog_s:g} s" if servos.watchdog_s else "for ever"
        yield (
            "servos.watchdog_s",
            f"{servos.watchdog_s:g} on a wall: without commands the wheels would go on turning {message}; "
            f"it takes more than 0, at most {WALL_WATCHDOG_S:g}",
        )
    if config.of(AdhesionConfig) is not None and config.exit.policy == "release" and not safety.tethered:
        yield (
            "exit.policy",
            "'release' on a wall: the robot would slide down when the work ends; 'hold', or safety.tethered "
            "= true for a robot on a tether",
        )
    limit_rad = config.robot.hold_limit_rad()
    if limit_rad is not None and safety.heading_limit_rad > limit_rad * _SAME and not safety.tethered:
        yield (
            "safety.heading_limit_rad",
            f"{safety.heading_limit_rad:g} rad is beyond {limit_rad:.3g} rad, where a robot of this "
            "robot.mass_kg, edf_force_n and thrust_compensation slides down a melamine wall; "
            "safety.tethered = true for a robot on a tether",
        )
    heading_rad = config.environment.start_pose[2]
    if abs(wrap(heading_rad)) > safety.heading_limit_rad:
        yield (
            "environment.start_pose",
            f"a heading of {heading_rad:g} rad is beyond safety.heading_limit_rad = "
            f"{safety.heading_limit_rad:g} rad ({math.degrees(safety.heading_limit_rad):.3g} deg), where a "
            "robot on a wall loses its hold; angles are in radians (--start takes degrees as 5deg)",
        )
    if safety.adhesion_limit_m_s2 < _LEAST_ADHESION_M_S2:
        yield (
            "safety.adhesion_limit_m_s2",
            f"{safety.adhesion_limit_m_s2:g} on a wall: no fall would be noticed; "
            f"at least {_LEAST_ADHESION_M_S2:g}",
        )
