"""Builds the emulated devices of a configuration in one world, in this process or as servers."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hil.bench.device_set_from_config import model_of
from hil.bench.further_device_errors import named
from hil.bench.injection import at_links, check_links, real_device
from hil.bench.third_party.checked_emulation import parts_of, wrapped_transport
from hil.bench.true_values import imperfections, true_bench
from hil.config.bench import BenchConfig
from hil.config.servo_models import DEFAULT_MODEL, ServoModel, servo_model
from hil.config.servos import ServosConfig
from hil.config.several_devices import resolve_device
from hil.core.clock import MonotonicClock
from hil.core.device import Connection
from hil.core.errors import ConfigError, FaultNotSupportedError, HilError, UsageError
from hil.core.registry import base_of, kinds
from hil.core.signals import KINDS
from hil.core.third_party_errors import OURS, PackageError, call_in_package
from hil.datasets.read import read_recordings
from hil.fakes.body_interface import Plant
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest, Transport
from hil.fakes.plant import RecordedMotion, RecordedRobot, SteppedBody, make_plant
from hil.fakes.server import EmulationServer
from hil.fakes.world import World, random_stream
from hil.faults.fault import Fault, Supported
from hil.faults.files import read_faults
from hil.faults.plan import FaultPlan

_NUMBERS = itertools.count(1)
_EMULATED = "an EmulatedDevice: connect() gives a Connection, serve() a Transport"
R = TypeVar("R")


def repeating_robot(config: BenchConfig) -> RecordedRobot:
    """The robot that repeats the recording of `emulation.replay`.

    Raises:
        ConfigError: the path holds more than one recording.
        DataError: the recording cannot be read, or is too short.
    """
    emulation, alignment = config.emulation, config.alignment
    path = str(emulation.replay)
    with _in_key(config, "emulation.replay"):
        found = read_recordings([Path(path)])
        if len(found) != 1:
            raise ConfigError(f"{path} holds {len(found)} recordings", expected="one", remedy="name one file")
    recording = found[0]
    motion = RecordedMotion(
        recording.name,
        recording.t_s,
        np.column_stack(
            [
                np.array(alignment.drive_sign) * recording.wheel_angle_rad,
                np.array(alignment.steer_sign) * recording.steering_rad + np.array(alignment.steer_zero_rad),
            ]
        ),
        recording.truth_t_s,
        recording.truth_pose,
    )
    return RecordedRobot(motion, tilt_rad=config.environment.tilt_rad, after_s=emulation.replay_after_s)


@contextmanager
def _in_key(config: BenchConfig, key: str) -> Iterator[None]:
    """Name the bench and a key of its file in an error about the value of that key; its class stays."""
    try:
        yield
    except HilError as error:
        reported = copy(error)
        message = f"{config.name}: {key}: {error.message}"
        HilError.__init__(reported, message, expected=error.expected, remedy=error.remedy)
        raise reported from error


@dataclass
class Connected:
    """Emulated devices in this process, by kind, and a way to release their channels."""

    connections: dict[str, Connection] = field(default_factory=dict)

    def close(self) -> None:
        """Release channel and line names. Idempotent."""
        while self.connections:
            self.connections.popitem()[1].close()


def build_world(config: BenchConfig, *, seed: int, faults: Sequence[Fault] = ()) -> World:
    """The robot on its surface at world time 0, without devices."""
    config, plan = true_bench(config), FaultPlan(faults)
    if config.emulation.replay is not None:
        from hil.bench.emulated_devices import repeating_robot  # imports readers of every kind of recording

        return World(repeating_robot(config), seed=seed, faults=plan)
    return World(_simulated(config, seed, plan), seed=seed, faults=plan)


def _simulated(config: BenchConfig, seed: int, plan: FaultPlan) -> Plant:
    """The robot of the configuration, in the configured physics model."""
    emulation, environment = config.emulation, config.environment
    common: dict[str, Any] = {
        "surface": environment.surface,
        "tilt_rad": environment.tilt_rad,
        "start_pose": environment.start_pose,
        "servos": _servo_model(config),
        "rng": random_stream(seed, "plant"),
        "randomise_truth": emulation.randomise_truth,
        "geometry_share": emulation.geometry_share,
        "faults": plan,
        "by_hand": environment.tilt_rad > 0.0,
    }
    if emulation.plant == "own":
        return make_plant(config.robot, **common)
    from hil.fakes.plant.mujoco import make_mujoco_plant

    mjcf = None if emulation.mjcf is None else Path(emulation.mjcf)
    return make_mujoco_plant(config.robot, contact=emulation.contact or "creep", mjcf=mjcf, **common)


def hidden_truth(world: World) -> dict[str, object]:
    """True parameters of the emulated robot, as JSON values; no measurement may use them.

    Raises:
        UsageError: the robot repeats a recording, so its parameters are unknown.
    """
    plant = world.plant
    if not isinstance(plant, SteppedBody):
        raise UsageError("the truth of a robot that repeats a recording is not known")
    p, geometry = plant.parameters, plant.parameters.geometry()
    return {
        **geometry.to_json(),
        "load": (plant.truth().normal_load_n / plant.truth().normal_load_n.mean()).tolist(),
        "mass_kg": p.mass_kg,
        "centre_of_mass_m": list(p.centre_of_mass_m),
        "friction": p.contact.friction,
    }


def _servo_model(config: BenchConfig) -> ServoModel:
    """The servo model that drives and steers the emulated robot."""
    servos = config.of(ServosConfig)
    return servo_model((servos and servos.model_number) or DEFAULT_MODEL)


def emulated(
    config: BenchConfig, world: World, kind: str, name: str, *, standard_ports: bool = False
) -> EmulatedDevice:
    """Build one emulated device of a bench in a world; it is not connected.

    Args:
        config: the bench configuration.
        world: the emulated world.
        kind: the device's kind.
        name: name of its line or channel.
        standard_ports: True to serve it at the usual ports of such devices.

    Raises:
        ConfigError: its model cannot be emulated, or `[emulation.KIND]` is wrong.
        PackageError: the package of the model returned no emulated device.
    """
    model = model_of(config, kind)
    if not model.chip:
        raise ConfigError(
            f"{config.name}: {kind}.model = {model.name!r} cannot be emulated",
            remedy="choose another model for the emulated bench, or a real one",
        )
    given, true = imperfections(config, kind), true_bench(config).devices()[kind]
    request = EmulationRequest(kind, true, given, world, name, standard_ports)
    if model.package != OURS:
        options = call_in_package(kind, model.package, "truth_options", model.truth_options)
        if options is not None:
            request.options(options)
    with parts_of(world, kind, model), named(base_of(kind), kind):
        device: EmulatedDevice | None = call_in_package(
            kind, model.package, "emulate", model.emulate, request
        )
    if device is None:
        raise PackageError(kind, model.package, "emulate gave None", expected=_EMULATED)
    return device


def _reached(config: BenchConfig, world: World, kind: str, name: str, reach: Callable[[], R | None]) -> R:
    """Call `connect` or `serve` of an emulated device, and check the result."""
    model = model_of(config, kind)
    with parts_of(world, kind, model), named(base_of(kind), kind):
        found = call_in_package(kind, model.package, f"{name}() of the emulated device", reach)
    if found is None:
        message = f"model {model.name} has no wire transport: serve() of the emulated device gave None"
        if name == "connect":
            message = f"connect() of the emulated device of model {model.name} gave None"
        raise PackageError(kind, model.package, message, expected=_EMULATED)
    return found


def connect_in_process(
    config: BenchConfig, world: World, *, only: Sequence[str] = (), links: Sequence[Fault] = ()
) -> Connected:
    """Connect all emulated devices of a bench (or `only` some) in this process, with unique names.

    Args:
        config: the bench configuration.
        world: the emulated world.
        only: names of the devices; empty for all emulated devices.
        links: faults of real devices, which no emulated device has to produce.

    Raises:
        FaultNotSupportedError: no emulated device can produce a planned fault.
    """
    number = next(_NUMBERS)
    connected = Connected()
    try:
        for kind in config.emulated():
            if not only or kind in only:
                device = emulated(config, world, kind, f"{kinds()[kind].shown_as}-{number}")
                connected.connections[kind] = _reached(config, world, kind, "connect", device.connect)
        with _in_key(config, "emulation.faults"):
            world.faults.check(among=[f for f in _faults(config, ()) if f not in links])
        world.faults.check()
    except HilError:
        connected.close()
        raise
    return connected


def planned_faults(
    config: BenchConfig, given: Sequence[Fault], *, inject_real: bool = False, by_hand: bool = False
) -> tuple[Fault, ...]:
    """Read all faults of a bench; whether emulated devices support them is checked when these are built.

    Args:
        config: the bench configuration; its faults come first.
        given: further faults.
        inject_real: True to inject faults of real devices at their links.
        by_hand: True if an operator does those of the power of real devices.

    Raises:
        UsageError, ConfigError: a fault that the configuration names cannot be read.
        FaultNotSupportedError: a fault of a real device that may not be injected.
    """
    faults = _faults(config, given)
    check_links(config, at_links(config, faults), consent=inject_real, by_hand=by_hand)
    if faults and not config.emulated() and (unknown := [f for f in faults if not real_device(config, f)]):
        raise FaultNotSupportedError(
            f"fault {unknown[0]}: {config.name} has no such device",
            expected="one of " + ", ".join(config.devices()),
        )
    return faults


def _faults(config: BenchConfig, given: Sequence[Fault]) -> tuple[Fault, ...]:
    """Faults of a bench, each with the name of its device resolved."""
    labels = {name: label for name, label in config.labels().items() if label or name not in KINDS}
    with _in_key(config, "emulation.faults"):
        own = read_faults(config.emulation.faults)
    return tuple(replace(fault, device=resolve_device(fault.device, labels)) for fault in (*own, *given))


def check_faults(
    config: BenchConfig,
    given: Sequence[Fault],
    *,
    only: Sequence[str] = (),
    inject_real: bool = False,
    by_hand: bool = False,
) -> tuple[Fault, ...]:
    """Read the faults of a bench, and refuse those that no device can produce.

    All emulated devices are built once, so that a wrong `[emulation.KIND]` is reported here. Nothing is
    opened.

    Args:
        config: the bench configuration; its faults come first.
        given: further faults.
        only: names of the devices that will be emulated; empty for all emulated devices of the bench.
        inject_real: True to inject faults of real devices at their links.
        by_hand: True if an operator does those of the power of real devices.

    Returns:
        All faults.

    Raises:
        UsageError, ConfigError: a fault of the configuration cannot be read, or a device cannot be emulated.
        FaultNotSupportedError: names the fault, the supported ones, and the one probably meant.
    """
    faults = planned_faults(config, given, inject_real=inject_real, by_hand=by_hand)
    if config.emulated():
        links = at_links(config, faults)
        chips = tuple(fault for fault in faults if fault not in links)
        connect_in_process(config, build_world(config, seed=0, faults=chips), only=only, links=links).close()
    return faults


def supported_faults(config: BenchConfig) -> dict[str, Supported]:
    """All faults that the emulated devices of a bench support, with their options, by device name."""
    world = build_world(config, seed=0)
    connect_in_process(config, world).close()
    return dict(world.faults.supported)


def faults_within(config: BenchConfig, given: Sequence[Fault]) -> tuple[Fault, ...]:
    """Faults of a bench whose device it has, emulated or real.

    Args:
        config: the bench; the faults that it names come first.
        given: further faults.

    Raises:
        UsageError, ConfigError: a fault that the configuration names cannot be read.
    """
    faults = _faults(config, given)
    known = supported_faults(config) if faults and config.emulated() else {}
    return tuple(fault for fault in faults if fault.device in known or real_device(config, fault))


def open_emulation(
    config: BenchConfig,
    *,
    only: Sequence[str] = (),
    seed: int = 0,
    faults: Sequence[str | Fault] = (),
    lifeline: int | None = None,
    await_start: bool = False,
    standard_ports: bool = False,
) -> EmulationServer:
    """Serve the emulated devices of a bench at real ports, in real time, for any client.

    Motion capture is served at the configured ports, else at free ones.

    Args:
        config: the bench configuration; its emulated devices are served.
        only: names of the devices to serve; all if empty.
        seed: seed of the world.
        faults: specs or paths of TOML timelines, in addition to those of the configuration.
        lifeline: file descriptor of a pipe; the server ends when its other end is closed.
        await_start: True if world time stands still until a byte arrives on the lifeline.
        standard_ports: True to use Motive's ports for motion capture, and python-can's group and port for
            CAN.

    Raises:
        FaultNotSupportedError, DeviceError, UsageError.
    """
    names = [n for n in config.emulated() if not only or n in only]
    if not names:
        raise UsageError(
            f"{config.name} has nothing to emulate",
            expected="emulated devices: --emulate or backend",
            remedy="use --bench emulated",
        )
    plan = check_faults(config, read_faults(faults), only=names)
    world = build_world(config, seed=seed, faults=plan)
    transports: dict[str, Transport] = {}
    try:
        for name in names:
            shown = kinds()[name].shown_as
            device = emulated(config, world, name, shown, standard_ports=standard_ports)
            transport = _reached(config, world, name, "serve", device.serve)
            transports[shown] = wrapped_transport(world, name, model_of(config, name), transport)
    except HilError:
        for transport in transports.values():
            transport.close()
        raise
    return EmulationServer(world, MonotonicClock(), transports, lifeline=lifeline, await_start=await_start)
