"""Four AS5045 behind a microcontroller that sends them on CAN."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.config.can_bus import SEARCH_S
from hil.config.encoders import EncodersConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import DeviceModel, Found, Search, opens
from hil.vocabulary.signals import EncoderSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting


def _driver(config: EncodersConfig, clock: Clock) -> Sensor[EncoderSample]:
    from hil.drivers.encoders import As5045Encoders

    return As5045Encoders(config, clock)


def _imperfections() -> type[Any]:
    from hil.fakes.encoders import EncoderTruthOptions

    return EncoderTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.canbus import channel_of, on_can
    from hil.fakes.encoders import EncoderNode, EncoderTruthOptions

    config: EncodersConfig = setting.config
    channel = channel_of(setting)
    EncoderNode(
        setting.world,
        channel,
        rate_hz=config.rate_hz,
        node_id=config.node_id,
        sign=config.sign,
        zero_rad=config.zeros_rad,
        options=setting.options(EncoderTruthOptions),
    )
    return on_can(setting, channel, subnet=163, dbc=config.dbc_path)


def _reach(endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
    from hil.devices.canbus import where

    return where(endpoint)


def _search(search: Search) -> Found | None:
    """Listen on the CAN buses that were named, or that the system has."""
    from hil.drivers.can_link import detected
    from hil.drivers.encoders import As5045Encoders

    for config in search.given.get("encoders") or detected(EncodersConfig, open_timeout_s=SEARCH_S):
        search.say(f"listening on {config.interface}:{config.channel}")
        if opens(As5045Encoders(config, search.clock)):
            return Found(config.table())
    return None


AS5045 = DeviceModel(
    kind="encoders",
    name="as5045",
    title="four AS5045 on a CAN node",
    config=EncodersConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
)
