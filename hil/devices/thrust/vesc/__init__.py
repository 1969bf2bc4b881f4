"""Propellers on VESC motor controllers, which say how fast they turn and stop when nobody commands them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.config.adhesion import VescConfig
from hil.devices.adhesion.on_buses import controllers
from hil.devices.thrust.vesc.config import MOST_CONTROLLERS, VescThrustConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import DeviceModel, Found, Search
from hil.vocabulary.signals import ThrustSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting
    from hil.drivers.adhesion.keeper.kept import Keep

_TOLD = ("controller_ids",)


def _driver(config: VescThrustConfig, clock: Clock, *, keep: Keep | None = None) -> Holding[ThrustSample]:
    from hil.devices.thrust.vesc.driver import VescThrust
    from hil.drivers.adhesion.keeper.deputy import KeptByProcess

    return VescThrust(config, clock, keep or KeptByProcess)


def _imperfections() -> type[Any]:
    from hil.devices.thrust.vesc.propellers import VescThrustTruthOptions

    return VescThrustTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.adhesion.in_world import kept_on_can
    from hil.devices.canbus import channel_of
    from hil.devices.thrust.vesc.propellers import VescThrustTruthOptions, propellers
    from hil.drivers.adhesion.vesc import DBC

    config: VescThrustConfig = setting.config
    channel = channel_of(setting)
    options = setting.options(VescThrustTruthOptions, timeout_s=config.timeout_s)
    nodes = propellers(setting.world, channel, config, options)
    return kept_on_can(setting, channel, nodes, subnet=166, dbc=DBC, told=_TOLD)


def _reach(endpoint: Mapping[str, Any]) -> dict[str, Any]:
    from hil.devices.canbus import where

    return where(endpoint, _TOLD)


def _search(search: Search) -> Found | None:
    """Ping the controllers on the CAN buses that were named, or that the system has; the fan's is none."""
    from hil.drivers.can_link import detected

    fan = VescConfig.model_validate(search.found["adhesion"]) if "adhesion" in search.found else None
    named = [c for c in search.given.get("thrust", ()) if isinstance(c, VescThrustConfig)]
    for config, ids in controllers(search, named or detected(VescThrustConfig)):
        others = [one for one in ids if fan is None or (config.bus, one) != (fan.bus, fan.controller_id)]
        own, left = others[:MOST_CONTROLLERS], others[MOST_CONTROLLERS:]
        if own:
            notes = [f"controllers {', '.join(map(str, own))} are taken for the propellers'"]
            notes += [f"nobody uses controllers {', '.join(map(str, left))}"] * bool(left)
            return Found(config.table(controller_ids=own), tuple(notes))
    return None


VESC_THRUST = DeviceModel(
    kind="thrust",
    name="vesc",
    title="propellers on VESCs",
    config=VescThrustConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
)
