"""Connects the emulated visual-inertial computer: on a serial line or by datagrams."""

from typing import Any

from hil.config.mavlink import MavlinkTrackerConfig, udp_address
from hil.core.device import Connection
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest, Transport, Wired, on_serial_line
from hil.fakes.tracker.mavlink.chip import VisualInertialComputer
from hil.fakes.tracker.mavlink.links import ComputerLink, MavlinkTransport, SerialComputer

_GROUND_STATION = ("127.0.0.1", 14550)
_ANY_HOST = "0.0.0.0"


def emulated(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The computer at the address of its table.

    Args:
        model: model of the bench file.
        request: world and table of the bench file.
    """
    computer, config = VisualInertialComputer.build(request), request.config
    if udp_address(config.port) is None:
        return on_serial_line(request, SerialComputer(computer, baud=config.baud))
    return Wired(
        lambda: Connection(parts={"link": ComputerLink(computer)}), lambda: _transport(request, computer)
    )


def _transport(request: EmulationRequest, computer: VisualInertialComputer) -> Transport:
    """On UDP: where the bench file says, at the usual ground station's port, or at a free port."""
    config: MavlinkTrackerConfig = request.config
    address = udp_address(config.port) if "port" in config.model_fields_set else None
    if address is None:
        return MavlinkTransport(computer, target=_GROUND_STATION if request.standard_ports else None)
    if address.role == "udpout":
        return MavlinkTransport(computer, host=address.host, port=address.port)
    host = _GROUND_STATION[0] if address.host == _ANY_HOST else address.host
    return MavlinkTransport(computer, target=(host, address.port))
