"""A fan behind a VESC on CAN."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.config.adhesion import VescConfig
from hil.devices.adhesion.on_buses import controllers
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import DeviceModel, Found, Search
from hil.vocabulary.signals import AdhesionSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting
    from hil.drivers.adhesion.keeper.kept import Keep

_TOLD = ("controller_id",)


def _driver(config: VescConfig, clock: Clock, *, keep: Keep | None = None) -> Holding[AdhesionSample]:
    """The fan's driver.

    Args:
        config: its table.
        clock: the bench clock.
        keep: makes who keeps a fan that is emulated in this process, where no other could reach it.
    """
    from hil.drivers.adhesion.fan import VescFan
    from hil.drivers.adhesion.keeper.deputy import KeptByProcess

    return VescFan(config, clock, keep or KeptByProcess)


def _imperfections() -> type[Any]:
    from hil.fakes.adhesion import AdhesionTruthOptions

    return AdhesionTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.adhesion.in_world import kept_on_can
    from hil.devices.canbus import channel_of
    from hil.drivers.adhesion.vesc import DBC
    from hil.fakes.adhesion import AdhesionTruthOptions, VescNode

    config: VescConfig = setting.config
    channel = channel_of(setting)
    options = setting.options(AdhesionTruthOptions, timeout_s=config.timeout_s)
    node = VescNode(setting.world, channel, config, options)
    return kept_on_can(setting, channel, [node], subnet=164, dbc=DBC, told=_TOLD)


def _reach(endpoint: Mapping[str, Any]) -> dict[str, Any]:
    from hil.devices.canbus import where

    return where(endpoint, _TOLD)


def _search(search: Search) -> Found | None:
    """Ping the controllers on the CAN buses that were named, or that the system has."""
    from hil.drivers.can_link import detected

    named = [c for c in search.given.get("adhesion", ()) if isinstance(c, VescConfig)]
    for config, ids in controllers(search, named or detected(VescConfig)):
        wanted = VescConfig().controller_id
        own = wanted if wanted in ids else ids[0]
        notes = (f"controllers {', '.join(map(str, ids))}: {own} is taken for the fan's",)
        return Found(config.table(controller_id=own), notes if len(ids) > 1 else ())
    return None


VESC = DeviceModel(
    kind="adhesion",
    name="vesc",
    title="a ducted fan on a VESC",
    config=VescConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
)
