"""The model `natnet` of the kind `mocap`."""

from collections.abc import Mapping
from typing import Any

from hil.config.mocap import MocapConfig
from hil.core.device import DeviceModel, Found, Search, can_open


class NatNet(DeviceModel):
    """OptiTrack Motive, reached by UDP at several ports; in one process the emulator passes datagrams."""

    kind, name, title = "mocap", "natnet", "OptiTrack Motive over NatNet"
    config, wire = MocapConfig, "udp"
    emulation = "hil.fakes.mocap.natnet.connection:emulated"
    driver, chip = "hil.drivers.mocap.natnet.driver:NatNetMocap", "hil.fakes.mocap.natnet.chip:NatNetServer"

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
        """Keys of the bench file that reach an emulated server."""
        where = {key: endpoint[key] for key in ("server", "command_port", "data_port", "multicast")}
        return {**where, "local_address": endpoint["server"]}

    def search(self, search: Search) -> Found | None:
        """Query the capture servers that the user has named."""
        for config in search.given.get("mocap", ()):
            search.say(f"asking the capture server {config.server}")
            if can_open(self.make_driver(config, search.clock)):
                return Found(config.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
        return None
