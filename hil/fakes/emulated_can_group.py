"""Assigns python-can's default `udp_multicast` group and ports to the emulated CAN buses of this host.

At standard ports the devices of one bus share a port, as they share a cable. The first bus of an emulator has
python-can's own port, each further one the next: its own bus hears every multicast group at the port that it
listens to. Elsewhere each device has a port of its own, and the first one of the host python-can's.
"""

from __future__ import annotations

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
    """A port that this process serves a bus at: the right to it, and how many devices are there."""

    number: int
    right: socket.socket
    devices: int = 0


_HELD: dict[tuple[str, int], _Held] = {}


def take_port(bus: str, bitrate: int, device: str) -> int:
    """The port of a bus for one more device of this process.

    Args:
        bus: its name in the bench file.
        bitrate: of the device, bit/s; devices of other bit rates are on a bus of their own.
        device: name in errors.

    Raises:
        DeviceError: another emulator of this host serves its first bus there.
    """
    held = _HELD.get((bus, bitrate))
    if held is None:
        held = _HELD[bus, bitrate] = _free(device)
    held.devices += 1
    return held.number


def leave_port(bus: str, bitrate: int) -> None:
    """One device fewer; with the last one the port is free again."""
    held = _HELD[bus, bitrate]
    held.devices -= 1
    if not held.devices:
        held.right.close()
        del _HELD[bus, bitrate]


def first_of_host() -> socket.socket | None:
    """The right to python-can's own port, for one device alone; None where it is taken."""
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
    """The next port; the first bus of an emulator needs python-can's own."""
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
    """Reserve a port while the socket is open; None where another program has it.

    The port itself cannot say so: all programs bind it shared. An abstract Unix address (Linux) is
    exclusive and vanishes with its owner.
    """
    right = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        right.bind("\0" + _NAME.format(number))
    except OSError:
        right.close()
        return None
    return right
