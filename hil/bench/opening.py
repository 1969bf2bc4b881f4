"""`open_bench`: decides how a bench runs and assembles it.

Three modes share the code: all devices emulated in virtual time (the default where all are emulated),
emulated devices served in real time by a separate process, and any mix with real devices.
"""

import logging
from collections.abc import Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

from hil.bench.bench import Bench
from hil.bench.by_hand import Hand
from hil.bench.camera_odometry import with_wheel_sigma
from hil.bench.device_set_from_config import make_device_set, model_of, served_here
from hil.bench.emulated_devices import build_world, check_faults, connect_in_process, planned_faults
from hil.bench.emulator_process import EmulatorProcess
from hil.bench.injection import Injection, at_links
from hil.bench.loop_settings import geometry_of, with_wheel_model
from hil.bench.pipelines import BenchModel
from hil.calibration.calibration_file import read_calibration
from hil.calibration.usability_check import check_usable, failed_validation
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core import bench_observers as opened_benches
from hil.core.clock import MonotonicClock
from hil.core.device import Connection
from hil.core.errors import DeviceError, UsageError
from hil.core.interfaces import Sink
from hil.core.registry import kinds
from hil.fakes.world import VirtualClock
from hil.faults.fault import Fault
from hil.faults.files import read_faults
from hil.support.lost_time import LostTime
from hil.support.port_users import programs_behind

LOG = logging.getLogger(__name__)


def open_bench(
    config: str | Path | BenchConfig = "emulated",
    *,
    emulate: str | tuple[str, ...] | None = None,
    seed: int = 0,
    realtime: bool = False,
    faults: str | Sequence[str | Fault] = (),
    overrides: Mapping[str, object] | None = None,
    sinks: tuple[Sink, ...] = (),
    calibration: str | Path | None = None,
    start_pose: Sequence[float] | None = None,
    inject_real: bool = False,
    by_hand: Hand | None = None,
) -> Bench:
    """Make a bench; enter it as a context manager.

    Args:
        config: path of a bench file, name of a shipped profile, or a configuration.
        emulate: `all` or names of devices to emulate; overrides the file.
        seed: seed of the emulated world; in virtual time the same seed gives the same run, bit for bit on the
            same arithmetic (`hil info`).
        realtime: True to serve the emulated devices in real time by a separate process.
        faults: a spec (`imu:stuck@2+3`) or the path of a TOML timeline, or several; added to those of the
            configuration.
        overrides: dotted configuration key -> value.
        sinks: sinks that receive every cycle.
        calibration: `calibration.toml`; overrides the one of the configuration.
        start_pose: pose of the robot, (3,): m, m, rad in the wall frame; overrides `environment.start_pose`.
            An emulated robot is placed there.
        inject_real: True to inject faults of real devices at their links; `[faults]` of the bench file
            must permit it, too.
        by_hand: operator who does faults of the power of real devices (`off`, `brownout`, `reset`), as
            `[faults]` of the bench file permits.

    Raises:
        ConfigError: the configuration or the calibration is wrong.
        FaultNotSupportedError: no device of the bench can produce a fault, or it may not be injected.
        DeviceError: the emulated devices cannot be served.
        UsageError: `seed` is not an integer >= 0; real devices in a pytest run whose command line does not
            name them.
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise UsageError(f"seed is {seed!r}", expected="a whole number, 0 or more")
    if start_pose is not None:
        overrides = {**(overrides or {}), "environment.start_pose": [float(v) for v in start_pose]}
    given = read_faults((faults,) if isinstance(faults, str) else faults)
    checked = load_bench(config, emulate=emulate, overrides=overrides, seed=seed).settled(realtime=realtime)
    opened_benches.call_guard(config, checked)
    model = _model(with_wheel_sigma(checked), calibration, int(seed))
    planned = planned_faults(model.config, given, inject_real=inject_real, by_hand=by_hand is not None)
    bench = _put_together(model, planned, sinks, by_hand, realtime=realtime)
    opened_benches.show(bench)
    return bench


def _put_together(
    model: BenchModel, plan: tuple[Fault, ...], sinks: tuple[Sink, ...], hand: Hand | None, *, realtime: bool
) -> Bench:
    """Assemble a bench from a model, with real, served or in-process emulated devices and their clock."""
    config = model.config
    if not config.emulated():
        return _real(model, plan, {}, sinks, None, hand)
    if realtime or len(config.emulated()) < len(config.devices()):
        return _at_the_wire(model, plan, sinks, hand)
    world = build_world(config, seed=model.seed, faults=plan)
    connected = connect_in_process(config, world)
    virtual = VirtualClock(world)
    devices = make_device_set(config, virtual, connected.connections, world.failures)
    bench = Bench(model, virtual, devices, world=world, sinks=sinks, faults=plan)
    bench.on_close(connected.close)
    return bench


def make_bench_model(
    config: str | Path | BenchConfig, *, calibration: str | Path | None = None
) -> BenchModel:
    """Make the model of a bench, without its devices.

    Args:
        config: path of a bench file, name of a shipped profile, or a configuration.
        calibration: `calibration.toml`; overrides the one of the configuration.

    Raises:
        ConfigError: the configuration or the calibration is wrong.
    """
    return _model(load_bench(config), calibration, 0)


def _at_the_wire(
    model: BenchModel, plan: tuple[Fault, ...], sinks: tuple[Sink, ...], hand: Hand | None
) -> Bench:
    config = model.config
    links = at_links(config, plan)
    chips = tuple(fault for fault in plan if fault not in links)
    served = config.model_copy(update={"emulation": config.emulation.model_copy(update={"faults": ()})})
    if chips:
        check_faults(served, chips)
    try:
        emulator = EmulatorProcess(served, seed=model.seed, faults=[str(f) for f in chips])
    except DeviceError:
        check_faults(served, chips)  # an error in a key of the bench file is reported instead
        raise
    bench = _real(model, plan, _reach(config, emulator.endpoints), sinks, emulator.pid, hand)
    bench.on_open(emulator.begin)
    bench.on_close(emulator.close)
    return bench


def _real(
    model: BenchModel,
    plan: tuple[Fault, ...],
    connections: Mapping[str, Connection],
    sinks: tuple[Sink, ...],
    emulator: int | None,
    hand: Hand | None,
) -> Bench:
    """A bench in real time, with the faults of its real devices in front of their drivers."""
    clock, config = MonotonicClock(), model.config
    behind = {one.pid for port in served_here(config).values() for one in programs_behind(port)}
    lost = LostTime(clock, sorted(behind if emulator is None else behind | {emulator}))
    injection = Injection(config, clock, at_links(config, plan), model.seed, hand)
    devices = make_device_set(config, clock, connections, lost=lost, in_front=injection.in_front_of)
    return Bench(model, clock, devices, sinks=sinks, faults=plan, injection=injection)


def _reach(config: BenchConfig, endpoints: Mapping[str, Mapping[str, Any]]) -> dict[str, Connection]:
    """Connections by kind, from the endpoints that `hil emulate` printed."""
    found = {}
    for kind in config.emulated():
        endpoint, model = endpoints[kinds()[kind].shown_as], model_of(config, kind)
        reached = model.connection(endpoint)
        found[kind] = reached if isinstance(reached, Connection) else Connection(reached)
    return found


def _model(config: BenchConfig, given: str | Path | None, seed: int) -> BenchModel:
    """Make the model from a configuration, with the wheels of its calibration or of the given one."""
    path = given if given is not None else config.calibration
    if path is None:
        return BenchModel(config, geometry=geometry_of(config), seed=seed)
    found = read_calibration(Path(path))
    check_usable(found, config, str(path))
    if failed := failed_validation(found, str(path)):
        LOG.warning("%s, and is used, as failed_calibration asks", failed)
    return BenchModel(
        with_wheel_model(config, found.model),
        geometry=found.geometry,
        calibration=f"{Path(path).name} version {found.version}{' (verdict FAIL)' if failed else ''}",
        fitted_with=found.model,
        seed=seed,
    )
