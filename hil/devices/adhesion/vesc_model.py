"""A fan behind a VESC on CAN."""

from __future__ import annotations

from typing import Any, ClassVar

from hil.config.adhesion import VescConfig
from hil.core.device import Found, Search, import_object
from hil.devices.adhesion.vesc_discovery import controllers
from hil.devices.serial_and_can_models import CanModel


class DaemonFan(CanModel):
    """A fan that the fan daemon commands; discovery skips it unless the model defines `search`."""

    dbc: ClassVar[str] = ""

    def emulate(self, request: Any) -> Any:
        """The controller on a bus of its own, commanded by a daemon in its world."""
        from hil.devices.adhesion.emulated_daemon import commanded_on_can
        from hil.devices.emulated_can import channel_of

        channel = channel_of(request)
        node = import_object(self.chip).build(request, channel)
        dbc = import_object(self.dbc) if self.dbc else ""
        return commanded_on_can(request, channel, [node], subnet=self.subnet, dbc=dbc, printed=self.printed)

    def search(self, search: Search) -> Found | None:
        """None: a query would make the asker a node of the bus."""
        return None

    @property
    def can_search(self) -> bool:
        """Whether the model defines `search`."""
        return type(self).search is not DaemonFan.search


class Vesc(DaemonFan):
    """A ducted fan on a VESC with the VESC's own CAN protocol."""

    kind, name, title = "adhesion", "vesc", "a ducted fan on a VESC"
    config, subnet, printed = VescConfig, 164, ("controller_id",)
    driver, chip = "hil.drivers.adhesion.vesc_fan:VescFan", "hil.fakes.adhesion:VescNode"
    dbc = "hil.links.vesc:DBC"

    def search(self, search: Search) -> Found | None:
        """Ping the controllers on the CAN buses that were named, or that the system has."""
        from hil.links.can_bus import detected

        named = [c for c in search.given.get("adhesion", ()) if isinstance(c, VescConfig)]
        for config, ids in controllers(search, named or detected(VescConfig)):
            wanted = VescConfig().controller_id
            own = wanted if wanted in ids else ids[0]
            notes = (f"controllers {', '.join(map(str, ids))}: {own} is taken for the fan's",)
            return Found(config.table(controller_id=own), notes if len(ids) > 1 else ())
        return None
