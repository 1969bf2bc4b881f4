"""Propellers on VESC motor controllers, which report their speed and stop when commands stop."""

from hil.config.adhesion import VescConfig
from hil.config.thrust_vesc import MOST_CONTROLLERS, VescThrustConfig
from hil.core.device import Found, Search
from hil.drivers.motor_controllers.vesc_discovery import controllers
from hil.drivers.serial_and_can_models import CanModel


class VescPropellers(CanModel):
    """VESCs on one CAN bus, commanded by the fan daemon; so `emulate` adds a daemon."""

    kind, name, title = "thrust", "vesc", "propellers on VESCs"
    config, subnet, printed = VescThrustConfig, 166, ("controller_ids",)
    driver, chip = "hil.drivers.thrust.vesc.driver:VescThrust", "hil.fakes.thrust.vesc.chip:PropellerNode"
    emulation = "hil.fakes.thrust.vesc.connection:emulated"

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
