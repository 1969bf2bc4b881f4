"""A fan whose motor controller speaks DroneCAN (UAVCAN v0): a VESC in that mode, or another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.devices.adhesion.dronecan.config import DroneCanConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import Connection, DeviceModel
from hil.vocabulary.signals import AdhesionSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting
    from hil.drivers.adhesion.keeper.kept import Keep

_TOLD = ("node_id", "esc_index")


def _driver(config: DroneCanConfig, clock: Clock, *, keep: Keep | None = None) -> Holding[AdhesionSample]:
    from hil.devices.adhesion.dronecan.driver import DroneCanFan
    from hil.drivers.adhesion.keeper.deputy import KeptByProcess

    return DroneCanFan(config, clock, keep or KeptByProcess)


def _imperfections() -> type[Any]:
    from hil.devices.adhesion.dronecan.node import DroneCanTruthOptions

    return DroneCanTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.adhesion.dronecan.node import DroneCanNode, DroneCanTruthOptions
    from hil.devices.adhesion.in_world import KeptInWorld
    from hil.devices.canbus import channel_of, on_can
    from hil.devices.emulated import Begun

    config: DroneCanConfig = setting.config
    channel = channel_of(setting)
    options = setting.options(DroneCanTruthOptions, timeout_s=config.timeout_s)
    node = DroneCanNode(setting.world, channel, config, options)
    told = {name: getattr(config, name) for name in _TOLD}
    device = on_can(
        setting, channel, subnet=164, dbc="", listens=True, told=told,
        parts={"keep": KeptInWorld(setting.world).keep},
    )  # fmt: skip
    return Begun(device, node.begin_in_use)


def _reach(endpoint: Mapping[str, Any]) -> Connection:
    from hil.devices.canbus import where

    return Connection({**where(endpoint, _TOLD), **{name: endpoint[name] for name in _TOLD}})


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
