"""A fan whose motor controller speaks DroneCAN (UAVCAN v0): a VESC in that mode, or another."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.devices.adhesion.dronecan.config import DroneCanConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import Connection, DeviceModel
from hil.vocabulary.signals import AdhesionSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_TOLD = ("node_id", "esc_index")


def _driver(
    config: DroneCanConfig, clock: Clock, *, emulator: int | None = None, here: bool = False
) -> Holding[AdhesionSample]:
    from functools import partial

    from hil.devices.adhesion.dronecan.driver import DroneCanFan
    from hil.drivers.adhesion.keeper.deputy import KeptByProcess
    from hil.drivers.adhesion.keeper.kept import KeptHere

    return DroneCanFan(config, clock, KeptHere if here else partial(KeptByProcess, emulator=emulator))


def _imperfections() -> type[Any]:
    from hil.devices.adhesion.dronecan.node import DroneCanTruthOptions

    return DroneCanTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.adhesion.dronecan.node import DroneCanNode, DroneCanTruthOptions
    from hil.devices.canbus import channel_of, on_can

    config: DroneCanConfig = setting.config
    channel = channel_of(setting)
    options = setting.options(DroneCanTruthOptions, timeout_s=config.timeout_s)
    node = DroneCanNode(setting.world, channel, config, options)
    told = {**{name: getattr(config, name) for name in _TOLD}, "pid": os.getpid()}
    return on_can(
        setting, channel, subnet=164, dbc="", listens=True, told=told, parts={"here": True},
        begin=node.begin_in_use,
    )  # fmt: skip


def _reach(endpoint: Mapping[str, Any]) -> Connection:
    from hil.devices.canbus import where

    values = where(endpoint, (*_TOLD, "pid"))
    return Connection(
        {**values, **{name: endpoint[name] for name in _TOLD}}, parts={"emulator": endpoint["pid"]}
    )


DRONECAN = DeviceModel(
    kind="adhesion",
    name="dronecan",
    title="a ducted fan on a controller that speaks DroneCAN",
    config=DroneCanConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    reach=_reach,
)
