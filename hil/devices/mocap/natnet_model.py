"""OptiTrack Motive over NatNet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.config.mocap import MocapConfig
from hil.core.device import Connection, DeviceModel, Found, Search, opens

_MOTIVE_PORTS = {"command_port": 1510, "data_port": 1511}
_MOTIVE_GROUP = "239.255.42.99"


class NatNet(DeviceModel):
    """It is reached by UDP at several ports, and in one process by datagrams: no serial port, no CAN bus."""

    kind, name, title = "mocap", "natnet", "OptiTrack Motive over NatNet"
    config = MocapConfig
    driver, chip = "hil.drivers.mocap:NatNetMocap", "hil.fakes.mocap:NatNetServer"

    def emulate(self, request: Any) -> Any:
        """A server of its own."""
        from hil.devices.emulated_device import Wired
        from hil.fakes.mocap import NatNetFace, NatNetServer

        server, config = NatNetServer.build(request), request.config
        if request.standard_ports:
            server.offered_group = _MOTIVE_GROUP
        chosen = {key: getattr(config, key) for key in _MOTIVE_PORTS if key in config.model_fields_set}
        ports = _MOTIVE_PORTS if request.standard_ports else chosen
        return Wired(
            lambda: Connection(parts={"datagrams": server.datagrams}), lambda: NatNetFace(server, **ports)
        )

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
        """Server and ports."""
        where = {key: endpoint[key] for key in ("server", "command_port", "data_port", "multicast")}
        return {**where, "local_address": endpoint["server"]}

    def search(self, search: Search) -> Found | None:
        """Ask the capture servers that were named."""
        for config in search.given.get("mocap", ()):
            search.say(f"asking the capture server {config.server}")
            if opens(self.make_driver(config, search.clock)):
                return Found(config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
        return None
