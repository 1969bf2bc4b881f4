"""Any visual-inertial computer that sends MAVLink `ODOMETRY` (331) or `VISION_POSITION_ESTIMATE` (102)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from hil.core.clock import Clock
from hil.core.device import Connection, DeviceModel, Found, Search
from hil.core.errors import HilError
from hil.core.finding import Finding
from hil.devices.tracker.mavlink.config import MavlinkTrackerConfig, udp_address
from hil.support.extras import is_installed

if TYPE_CHECKING:
    from hil.devices.doctor_watch import Watched
    from hil.devices.emulated_device import EmulationRequest, Transport
    from hil.devices.tracker.mavlink.emulated_computer import VisualInertialComputer

__all__ = ["Mavlink"]

_HERE = "hil.devices.tracker.mavlink"
_GROUND_STATION = ("127.0.0.1", 14550)
_ANY_HOST = "0.0.0.0"
_LISTEN_S = 0.5


class Mavlink(DeviceModel):
    """A visual-inertial computer, reached by UDP or at a serial port by the address in its table."""

    kind, name, title = "tracker", "mavlink", "visual-inertial computer that sends MAVLink odometry"
    config, probe_order, framing = MavlinkTrackerConfig, 9, "mavlink"
    driver, chip = f"{_HERE}.driver:MavlinkTracker", f"{_HERE}.emulated_computer:VisualInertialComputer"

    def wire_of(self, config: MavlinkTrackerConfig) -> str:
        """`udp` or `serial`, by the address."""
        return "serial" if udp_address(config.port) is None else "udp"

    def emulate(self, request: EmulationRequest) -> Any:
        """Emulate the computer at the address of the table."""
        from hil.devices.emulated_device import Wired, on_serial_line
        from hil.devices.tracker.mavlink.emulated_computer import VisualInertialComputer
        from hil.devices.tracker.mavlink.emulated_links import ComputerLink, SerialComputer

        computer, config = VisualInertialComputer.build(request), request.config
        if udp_address(config.port) is None:
            return on_serial_line(request, SerialComputer(computer, baud=config.baud))
        return Wired(
            lambda: Connection(parts={"link": ComputerLink(computer)}), lambda: _transport(request, computer)
        )

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


def _transport(request: EmulationRequest, computer: VisualInertialComputer) -> Transport:
    """On UDP: where the bench file says, at the usual ground station's port, or at a free port."""
    from hil.devices.tracker.mavlink.emulated_links import MavlinkTransport

    config: MavlinkTrackerConfig = request.config
    address = udp_address(config.port) if "port" in config.model_fields_set else None
    if address is None:
        return MavlinkTransport(computer, target=_GROUND_STATION if request.standard_ports else None)
    if address.role == "udpout":
        return MavlinkTransport(computer, host=address.host, port=address.port)
    host = _GROUND_STATION[0] if address.host == _ANY_HOST else address.host
    return MavlinkTransport(computer, target=(host, address.port))
