"""Propellers on VESC motor controllers, which report their speed and stop when commands stop."""

from __future__ import annotations

from typing import Any

from hil.config.adhesion import VescConfig
from hil.core.device import Found, Search
from hil.devices.adhesion.vesc_discovery import controllers
from hil.devices.serial_and_can_models import CanModel
from hil.devices.thrust.vesc.config import MOST_CONTROLLERS, VescThrustConfig

_HERE = "hil.devices.thrust.vesc"


class VescPropellers(CanModel):
    """VESCs on one CAN bus, commanded by the fan daemon; so `emulate` adds a daemon."""

    kind, name, title = "thrust", "vesc", "propellers on VESCs"
    config, subnet, printed = VescThrustConfig, 166, ("controller_ids",)
    driver, chip = f"{_HERE}.driver:VescThrust", f"{_HERE}.emulated_propellers:PropellerNode"

    def emulate(self, request: Any) -> Any:
        """Controllers on a bus of their own, commanded by a daemon in their world."""
        from hil.devices.adhesion.emulated_daemon import commanded_on_can
        from hil.devices.emulated_can import channel_of
        from hil.devices.thrust.vesc.emulated_propellers import VescThrustTruthOptions, propellers
        from hil.links.vesc import DBC

        channel = channel_of(request)
        options = request.options(VescThrustTruthOptions, timeout_s=request.config.timeout_s)
        nodes = propellers(request.world, channel, request.config, options)
        return commanded_on_can(request, channel, nodes, subnet=self.subnet, dbc=DBC, printed=self.printed)

    def search(self, search: Search) -> Found | None:
        """Ping the controllers on the named CAN buses, or on the system's, except the fan's controller."""
        from hil.links.can_bus import detected

        fan = VescConfig.model_validate(search.found["adhesion"]) if "adhesion" in search.found else None
        named = [c for c in search.given.get("thrust", ()) if isinstance(c, VescThrustConfig)]
        for config, ids in controllers(search, named or detected(VescThrustConfig)):
            others = [one for one in ids if fan is None or (config.bus, one) != (fan.bus, fan.controller_id)]
            own, left = others[:MOST_CONTROLLERS], others[MOST_CONTROLLERS:]
            if own:
                notes = [f"controllers {', '.join(map(str, own))} are taken for the propellers'"]
                notes += [f"no table uses controllers {', '.join(map(str, left))}"] * bool(left)
                return Found(config.table(controller_ids=own), tuple(notes))
        return None
