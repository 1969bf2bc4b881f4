"""A fan whose motor controller speaks DroneCAN (UAVCAN v0): a VESC in that mode, or another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.devices.adhesion.dronecan.config import DroneCanConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import DeviceModel
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
    from hil.devices.adhesion.in_world import kept_on_can
    from hil.devices.canbus import channel_of

    config: DroneCanConfig = setting.config
    channel = channel_of(setting)
    options = setting.options(DroneCanTruthOptions, timeout_s=config.timeout_s)
    node = DroneCanNode(setting.world, channel, config, options)
    return kept_on_can(setting, channel, [node], subnet=164, dbc="", told=_TOLD)


def _reach(endpoint: Mapping[str, Any]) -> dict[str, Any]:
    from hil.devices.canbus import where

    return where(endpoint, _TOLD)


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
