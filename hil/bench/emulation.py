"""The emulated devices of a configuration: built in one world, connected in process or served."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from hil.bench.drivers import Connections
from hil.bench.repeating import repeating_robot
from hil.config.bench import BenchConfig
from hil.fakes.can_wire import DEFAULT_GROUP, CanChannel, CanFace
from hil.fakes.encoders import EncoderNode, EncoderTruthOptions
from hil.fakes.faults import Fault, FaultPlan, describe
from hil.fakes.imu import Bno055Chip, ImuTruthOptions
from hil.fakes.mocap import MocapTruthOptions, NatNetFace, NatNetServer
from hil.fakes.plant import make_plant
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer, Face
from hil.fakes.servos import ServoBus, ServoBusOptions
from hil.fakes.timeline import read_faults
from hil.fakes.tracker import T265, TrackerFace, TrackerTruthOptions
from hil.fakes.world import World, random_stream
from hil.vocabulary.clock import Clock, MonotonicClock
from hil.vocabulary.errors import ConfigError, FaultNotSupportedError, HilError, UsageError

_IMU_LATENCY_S = 0.001
_MOTIVE_PORTS = {"command_port": 1510, "data_port": 1511}
_NUMBERS = itertools.count(1)

T = TypeVar("T")


@dataclass
class Connected:
    """Emulated devices in this process, and how to let go of what they occupy."""

    connections: Connections
    closers: list[Callable[[], None]] = field(default_factory=list)

    def close(self) -> None:
        """Free channel and line names. Idempotent."""
        while self.closers:
            self.closers.pop()()


def build_world(config: BenchConfig, *, seed: int, faults: Sequence[Fault] = ()) -> World:
    """The robot on its surface at world time 0, without devices."""
    plan = FaultPlan(faults)
    emulation, environment = config.emulation, config.environment
    if emulation.replay is not None:
        return World(repeating_robot(config), seed=seed, faults=plan)
    plant = make_plant(
        config.robot,
        surface=environment.surface,
        tilt_rad=environment.tilt_rad,
        start_pose=environment.start_pose,
        rng=random_stream(seed, "plant"),
        randomise_truth=emulation.randomise_truth,
        geometry_share=emulation.geometry_share,
        faults=plan,
        by_hand=environment.tilt_rad > 0.0,
    )
    return World(plant, seed=seed, faults=plan)


def connect_in_process(config: BenchConfig, world: World, *, only: Sequence[str] = ()) -> Connected:
    """All emulated devices of a bench (or `only` some) in this process, on names of their own.

    Raises:
        FaultNotSupportedError: a fault that none of them can produce.
    """
    number = next(_NUMBERS)
    connected = Connected(Connections())
    values = connected.connections.values
    try:
        for name in config.emulated():
            if only and name not in only:
                continue
            if name in _SERIAL:
                line = _SERIAL[name](config, world, f"{name}-{number}").open()
                connected.closers.append(line.close)
                values[name] = {"port": f"hil://{line.name}"}
            elif name == "encoders":
                channel = _encoders(config, world, f"can-{number}").open()
                connected.closers.append(channel.close)
                values[name] = {"interface": "hil", "channel": channel.name, "options": {}}
            elif name == "tracker":
                connected.connections.pipeline = _tracker(config, world).pipeline()
            elif name == "mocap":
                connected.connections.datagrams = _mocap(config, world).datagrams
        world.faults.check()
    except HilError:
        connected.close()
        raise
    return connected


def check_faults(
    config: BenchConfig, given: Sequence[str | Fault], *, only: Sequence[str] = ()
) -> tuple[Fault, ...]:
    """Read the faults of a bench, and refuse what none of its emulated devices can produce.

    Nothing is opened.

    Args:
        config: the bench; the faults that it names come first.
        given: further specs or paths of TOML timelines.
        only: names of the devices that will be emulated; all that the bench emulates when empty.

    Returns:
        All faults.

    Raises:
        UsageError, ConfigError: a spec or a file that cannot be read.
        FaultNotSupportedError: naming the fault, what would do, and what was probably meant.
    """
    faults = read_faults((*config.emulation.faults, *given))
    if faults and not config.emulated():
        raise FaultNotSupportedError(
            f"fault {describe(faults[0])}: every device of {config.name} is real",
            remedy="use --emulate for the devices that faults are meant for",
        )
    if faults:
        connect_in_process(config, build_world(config, seed=0, faults=faults), only=only).close()
    return faults


def open_emulation(
    config: BenchConfig,
    *,
    only: Sequence[str] = (),
    seed: int = 0,
    faults: Sequence[str | Fault] = (),
    clock: Clock | None = None,
    lifeline: int | None = None,
    await_start: bool = False,
    standard_ports: bool = False,
) -> EmulationServer:
    """The emulated devices of a bench at the wire, in real time, for any client.

    Motion capture is served at the ports that the configuration names, else at free ones.

    Args:
        config: the bench; its emulated devices are served.
        only: names to restrict them to.
        seed: seed of the world.
        faults: specs or paths of TOML timelines, beside those of the configuration.
        clock: what the world follows; the host's monotonic clock by default.
        lifeline: file descriptor of a pipe; the server ends when its other end is closed.
        await_start: world time stands still until a byte comes down the lifeline.
        standard_ports: motion capture at Motive's ports, CAN in python-can's own multicast group.

    Raises:
        FaultNotSupportedError, DeviceError, UsageError.
    """
    names = [n for n in config.emulated() if not only or n in only]
    if not names:
        raise UsageError(
            f"{config.name} has nothing to emulate", expected="emulated devices: --emulate or backend",
            remedy="use --bench emulated",
        )  # fmt: skip
    plan = check_faults(config, faults, only=names)
    world = build_world(config, seed=seed, faults=plan)
    faces: dict[str, Face] = {}
    try:
        for name in names:
            faces["can" if name == "encoders" else name] = _FACES[name](config, world, standard_ports)
    except HilError:
        for face in faces.values():
            face.close()
        raise
    return EmulationServer(
        world, clock or MonotonicClock(), faces, lifeline=lifeline, await_start=await_start
    )


def _options(kind: type[T], config: BenchConfig, device: str, **known: Any) -> T:
    """True imperfections of a device from the configuration; raises `ConfigError` with the key."""
    given = {**known, **getattr(config.emulation, device)}
    names = [f.name for f in fields(kind)]  # type: ignore[arg-type]
    problems = [f"emulation.{device}.{key}: unknown; one of {', '.join(names)}" for key in given
                if key not in names]  # fmt: skip
    if not problems:
        try:
            return TypeAdapter(kind).validate_python(given)
        except ValidationError as error:
            problems = [f"emulation.{device}.{e['loc'][0]}: {e['msg']}" for e in error.errors()]
    raise ConfigError(f"{config.name}: {len(problems)} problem(s)", problems=tuple(problems))


def _servos(config: BenchConfig, world: World, name: str = "") -> SerialLine:
    servos = config.servos
    assert servos is not None
    known = {
        "ids": servos.ids,
        "baud": servos.baud,
        "model_by_joint": dict.fromkeys(range(8), servos.model_number),
    }
    bus = ServoBus(world, options=_options(ServoBusOptions, config, "servos", **known))
    return SerialLine(world, bus, name=name, latency_s=servos.usb_latency_s)


def _imu(config: BenchConfig, world: World, name: str = "") -> SerialLine:
    imu = config.imu
    assert imu is not None
    chip = Bno055Chip(
        world,
        options=_options(ImuTruthOptions, config, "imu", position_m=imu.mount_position_m),
        mount_rotation_wxyz=imu.mount_rotation_wxyz,
        bench_remap=(imu.axis_map, imu.axis_sign),
    )
    return SerialLine(world, chip, name=name, latency_s=_IMU_LATENCY_S)


def _encoders(config: BenchConfig, world: World, name: str) -> CanChannel:
    encoders = config.encoders
    assert encoders is not None
    channel = CanChannel(world, name, bitrate=encoders.bitrate)
    EncoderNode(
        world,
        channel,
        rate_hz=encoders.rate_hz,
        node_id=encoders.node_id,
        sign=encoders.sign,
        zero_rad=encoders.zero_rad,
        options=_options(EncoderTruthOptions, config, "encoders"),
    )
    return channel


def _tracker(config: BenchConfig, world: World) -> T265:
    tracker = config.tracker
    assert tracker is not None
    return T265(
        world,
        options=_options(TrackerTruthOptions, config, "tracker"),
        mount_position_m=tracker.mount_position_m,
        mount_rotation_wxyz=tracker.mount_rotation_wxyz,
    )


def _mocap(config: BenchConfig, world: World) -> NatNetServer:
    mocap = config.mocap
    assert mocap is not None
    body: dict[str, Any] = {"body": mocap.body} if isinstance(mocap.body, str) else {"body_id": mocap.body}
    return NatNetServer(
        world, options=_options(MocapTruthOptions, config, "mocap"), up_axis=mocap.up_axis,
        command_port=mocap.command_port, data_port=mocap.data_port, multicast=mocap.multicast, **body,
    )  # fmt: skip


def _servo_face(config: BenchConfig, world: World, standard_ports: bool) -> Face:
    assert config.servos is not None
    nominal: dict[str, object] = {"baud": config.servos.baud, "ids": list(config.servos.ids)}
    return SerialPty(_servos(config, world), nominal)


def _imu_face(config: BenchConfig, world: World, standard_ports: bool) -> Face:
    assert config.imu is not None
    return SerialPty(_imu(config, world), {"baud": config.imu.baud})


def _can_face(config: BenchConfig, world: World, standard_ports: bool) -> Face:
    assert config.encoders is not None
    address = DEFAULT_GROUP if standard_ports else f"239.74.163.{2 + os.getpid() % 250}"
    return CanFace(_encoders(config, world, "can"), address=address, dbc=config.encoders.dbc_path)


def _tracker_face(config: BenchConfig, world: World, standard_ports: bool) -> Face:
    return TrackerFace(_tracker(config, world))


def _mocap_face(config: BenchConfig, world: World, standard_ports: bool) -> Face:
    assert config.mocap is not None
    chosen = {k: getattr(config.mocap, k) for k in _MOTIVE_PORTS if k in config.mocap.model_fields_set}
    return NatNetFace(_mocap(config, world), **(_MOTIVE_PORTS if standard_ports else chosen))


_SERIAL: dict[str, Callable[[BenchConfig, World, str], SerialLine]] = {"servos": _servos, "imu": _imu}
_FACES: dict[str, Callable[[BenchConfig, World, bool], Face]] = {
    "servos": _servo_face,
    "imu": _imu_face,
    "encoders": _can_face,
    "tracker": _tracker_face,
    "mocap": _mocap_face,
}
