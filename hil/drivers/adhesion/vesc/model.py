"""A fan behind a VESC on CAN."""

from hil.config.adhesion import VescConfig
from hil.core.device import Found, Search
from hil.drivers.adhesion.daemon_fan import DaemonFan
from hil.drivers.motor_controllers.vesc_discovery import controllers


class Vesc(DaemonFan):
    """A ducted fan on a VESC with the VESC's own CAN protocol."""

    kind, name, title = "adhesion", "vesc", "a ducted fan on a VESC"
    config, subnet, printed = VescConfig, 164, ("controller_id",)
    driver, chip = (
        "hil.drivers.adhesion.vesc.driver:VescFan",
        "hil.fakes.motor_controllers.vesc_node:VescNode",
    )
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
