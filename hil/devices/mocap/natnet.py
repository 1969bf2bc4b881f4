"""OptiTrack Motive over NatNet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.config.mocap import MocapConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import Connection, DeviceModel, Found, Search, opens
from hil.vocabulary.signals import MocapSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_MOTIVE_PORTS = {"command_port": 1510, "data_port": 1511}
_MOTIVE_GROUP = "239.255.42.99"


def _driver(config: MocapConfig, clock: Clock, datagrams: Any = None) -> Sensor[MocapSample]:
    from hil.drivers.mocap import NatNetMocap

    return NatNetMocap(config, clock, datagrams=datagrams)


def _imperfections() -> type[Any]:
    from hil.fakes.mocap import MocapTruthOptions

    return MocapTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import Wired
    from hil.fakes.mocap import MocapTruthOptions, NatNetFace, NatNetServer

    config: MocapConfig = setting.config
    body: dict[str, Any] = {"body": config.body} if isinstance(config.body, str) else {"body_id": config.body}
    options = setting.options(MocapTruthOptions)
    major, minor = map(int, options.natnet.split("."))
    server = NatNetServer(
        setting.world,
        options=options,
        version=(major, minor),
        up_axis=config.up_axis,
        command_port=config.command_port,
        data_port=config.data_port,
        multicast=config.multicast,
        **body,
    )
    if setting.standard_ports:
        server.offered_group = _MOTIVE_GROUP
    chosen = {key: getattr(config, key) for key in _MOTIVE_PORTS if key in config.model_fields_set}
    ports = _MOTIVE_PORTS if setting.standard_ports else chosen
    return Wired(
        lambda: Connection(parts={"datagrams": server.datagrams}), lambda: NatNetFace(server, **ports)
    )


def _reach(endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
    where = {key: endpoint[key] for key in ("server", "command_port", "data_port", "multicast")}
    return {**where, "local_address": endpoint["server"]}


def _search(search: Search) -> Found | None:
    """Ask the capture servers that were named."""
    from hil.drivers.mocap import NatNetMocap

    for config in search.given.get("mocap", ()):
        search.say(f"asking the capture server {config.server}")
        if opens(NatNetMocap(config, search.clock)):
            return Found(config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
    return None


NATNET = DeviceModel(
    kind="mocap",
    name="natnet",
    title="OptiTrack Motive over NatNet",
    config=MocapConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
)
