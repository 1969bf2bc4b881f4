"""Assigns python-can's default `udp_multicast` group and ports to the emulated CAN buses of this host.

With standard ports, the devices of one bus share a port, as they share a cable. The first bus of an emulator
uses python-can's own port and each further bus the next one, because a python-can bus receives every
multicast group at its port. Otherwise each device has its own port, the first of the host python-can's.
"""

import socket
from dataclasses import dataclass

from hil.core.errors import DeviceError
from hil.support.emulated_can_mark import MULTICAST_PORT
from hil.support.port_users import ending, named, programs_with_name

DEFAULT_GROUP = "239.74.163.2"
DEFAULT_PORT = MULTICAST_PORT
_MOST_BUSES = 16
_NAME = "hil-can-{}"


@dataclass
class _Held:
    """A port at which this process serves a bus, the socket that reserves it, and its number of devices."""

    number: int
    right: socket.socket
    devices: int = 0


_HELD: dict[tuple[str, int], _Held] = {}


def take_port(bus: str, bitrate: int, device: str) -> int:
    """Return the port of a bus and count one more device on it.

    Args:
        bus: name of the bus in the bench file.
        bitrate: bit rate of the device, bit/s; devices with another bit rate are on a separate bus.
        device: device name for error messages.

    Raises:
        DeviceError: another emulator of this host already serves its first bus there.
    """
    held = _HELD.get((bus, bitrate))
    if held is None:
        held = _HELD[bus, bitrate] = _free(device)
    held.devices += 1
    return held.number


def leave_port(bus: str, bitrate: int) -> None:
    """Count one device less on a bus; after the last one the port is released."""
    held = _HELD[bus, bitrate]
    held.devices -= 1
    if not held.devices:
        held.right.close()
        del _HELD[bus, bitrate]


def first_of_host() -> socket.socket | None:
    """Reserve python-can's own port for a single device; None if it is taken."""
    right = _right_to(DEFAULT_PORT)
    if right is None:
        return None
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", DEFAULT_PORT))
    except OSError:
        right.close()
        return None
    return right


def _free(device: str) -> _Held:
    """Reserve the next free port; the first bus of an emulator must get python-can's own."""
    for number in range(DEFAULT_PORT, DEFAULT_PORT + (_MOST_BUSES if _HELD else 1)):
        if (right := _right_to(number)) is not None:
            return _Held(number, right)
    users = programs_with_name(_NAME.format(DEFAULT_PORT))
    other = f"{named(users)} of this computer serves" if users else "another emulator of this computer serves"
    raise DeviceError(
        device,
        f"{other} CAN there",
        port=f"udp_multicast:{DEFAULT_GROUP}",
        expected=f"python-can's own port {DEFAULT_PORT} for this one alone",
        remedy=f"end it{ending(users)}, or leave --standard-ports out",
    )


def _right_to(number: int) -> socket.socket | None:
    """Reserve a port number while the returned socket is open; None if another program holds it.

    Binding the port cannot show this, because all programs bind it shared. An abstract Unix address (Linux)
    is exclusive and is released when its process ends.
    """
    right = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        right.bind("\0" + _NAME.format(number))
    except OSError:
        right.close()
        return None
    return right
