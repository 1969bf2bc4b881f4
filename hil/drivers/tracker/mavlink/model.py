"""Any visual-inertial computer that sends MAVLink `ODOMETRY` (331) or `VISION_POSITION_ESTIMATE` (102)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from hil.config.mavlink import MavlinkTrackerConfig, udp_address
from hil.core.clock import Clock
from hil.core.device import DeviceModel, Found, Search
from hil.core.errors import HilError
from hil.core.finding import Finding
from hil.support.extras import is_installed

if TYPE_CHECKING:
    from hil.drivers.doctor_watch import Watched

__all__ = ["Mavlink"]

_LISTEN_S = 0.5


class Mavlink(DeviceModel):
    """A visual-inertial computer, reached by UDP or at a serial port by the address in its table."""

    kind, name, title = "tracker", "mavlink", "visual-inertial computer that sends MAVLink odometry"
    config, probe_order, framing = MavlinkTrackerConfig, 9, "mavlink"
    driver = "hil.drivers.tracker.mavlink.driver:MavlinkTracker"
    chip = "hil.fakes.tracker.mavlink.chip:VisualInertialComputer"
    emulation = "hil.fakes.tracker.mavlink.connection:emulated"

    def wire_of(self, config: MavlinkTrackerConfig) -> str:
        """`udp` or `serial`, by the address."""
        return "serial" if udp_address(config.port) is None else "udp"

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Listen for odometry at a serial port."""
        return self._listen(MavlinkTrackerConfig(port=port, open_timeout_s=_LISTEN_S), clock)

    def search(self, search: Search) -> Found | None:
        """Listen for odometry at the addresses that the user has named, or at the port of ground stations."""
        named = [c for c in search.given.get("tracker", ()) if isinstance(c, MavlinkTrackerConfig)]
        for config in named or [MavlinkTrackerConfig()]:
            search.say(f"listening for MAVLink odometry at {config.port}")
            found = self._listen(config.model_copy(update={"open_timeout_s": _LISTEN_S}), search.clock)
            if found is not None:
                return found
        return None

    def check(self, watched: Watched) -> Iterable[Finding]:
        """Sender, time, frames, quality, rate."""
        findings: Iterable[Finding] = watched.device.findings(watched.samples, watched.watch_s)
        return findings

    def _listen(self, config: MavlinkTrackerConfig, clock: Clock) -> Found | None:
        """Listen for odometry; None where there is none, or without pymavlink."""
        if not is_installed("mavlink"):
            return None
        tracker = self.make_driver(config, clock)
        try:
            tracker.open()
        except HilError:
            return None
        reported = tracker.identity()
        tracker.close()
        ids = {"system_id": int(reported["system"]), "component_id": int(reported["component"].split()[0])}
        sender = ", ".join(f"{key} {value}" for key, value in reported.items() if key != "port")
        return Found({"port": config.port, **ids}, (f"tracker: {sender}; set tracker.rate_hz to its rate",))
