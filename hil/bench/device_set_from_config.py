"""Makes the drivers of a checked configuration, each with the address of its device."""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, cast

from hil.bench.device_files import file_of_the_bench, named_files
from hil.bench.device_proxy import DeviceWithin
from hil.bench.further_device_errors import making, named
from hil.bench.third_party.checked_driver import wrapped_driver
from hil.config.bench import BenchConfig
from hil.config.device import DeviceConfig
from hil.core.clock import Clock
from hil.core.device import Connection, DeviceModel
from hil.core.errors import HilError
from hil.core.interfaces import Actuators, Device, Sensor
from hil.core.registry import base_of, kinds
from hil.loop.device_set import DeviceSet
from hil.support.lost_time import LostTime
from hil.support.port_users import is_pseudo_terminal


def model_of(config: BenchConfig, kind: str) -> DeviceModel:
    """The device model of a configured device."""
    table = config.devices()[kind]
    return kinds()[kind].model(getattr(table, "model"))  # noqa: B009 - every model's table has the key


def served_here(config: BenchConfig) -> dict[str, str]:
    """Ports of real devices that a program of this computer serves, as `hil emulate` does, by device."""
    ports = {name: str(getattr(table, "port", "")) for name, table in config.devices().items()}
    return {
        name: port
        for name, port in ports.items()
        if name not in config.emulated() and is_pseudo_terminal(port)
    }


def make_device_set(
    config: BenchConfig,
    clock: Clock,
    connections: Mapping[str, Connection],
    failures: Mapping[str, HilError] = MappingProxyType({}),
    lost: LostTime | None = None,
    in_front: Callable[[str, Device], Device] = lambda name, driver: driver,
) -> DeviceSet:
    """Make the drivers of all configured devices; they are not opened.

    Args:
        config: the bench configuration.
        clock: the bench clock.
        connections: connections to emulated devices, by kind; empty for a bench of hardware.
        failures: errors of emulated devices, by kind; filled when they occur.
        lost: counts the time that this computer takes from the loop; None in virtual time.
        in_front: puts faults in front of the driver of a real device, by its name.
    """

    def driver(name: str, table: DeviceConfig) -> Device:
        found = connections.get(name, Connection())
        at = table.model_copy(update=dict(found.values))
        model, kind = model_of(config, name), base_of(name)
        make = partial(model.make_driver, at, clock, **found.parts)
        made: Callable[[], Device] = make if kind == name else making(make, name)
        device = wrapped_driver(kinds()[name], model, made, failures, at.timeouts_s())
        if files := named_files(table):
            device = DeviceWithin(device, partial(file_of_the_bench, config.name, name, files), name)
        return device if kind == name else DeviceWithin(device, partial(named, kind, name), name)

    made = {name: in_front(name, driver(name, table)) for name, table in config.devices().items()}
    known = {name: kinds()[name] for name in made}
    moving = [made[name] for name, kind in known.items() if kind.moves_robot and not kind.holds_robot]
    holding = {name: made[name] for name, kind in known.items() if kind.holds_robot}
    sensing = {
        name: made[name] for name, kind in known.items() if not kind.moves_robot and not kind.holds_robot
    }
    return DeviceSet(
        clock,
        cast("Actuators", moving[0]) if moving else None,
        cast("dict[str, Sensor[Any]]", {**holding, **sensing}),
        lost,
    )
