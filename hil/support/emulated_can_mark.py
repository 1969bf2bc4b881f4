"""Marks a CAN bus as emulated while the emulating process lives, by a name in the kernel.

The daemon of a fan must not end before the fan. A real fan keeps running when every program has ended; an
emulated one ends with its emulator. The mark is a name in Linux' abstract socket namespace; on other systems
no bus is marked. Any user of the machine can take a name there, so a mark counts only for multicast groups,
the buses that are emulated, and never for an adapter: it cannot end the daemon of a real fan.

Multicast has no bit rate, so a second name holds that of the emulated bus.
"""

import contextlib
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

MULTICAST_PORT = 43113
"""Default port of python-can's `udp_multicast`."""
_EMULATED = "udp_multicast"
_AT = ", bit/s: "
_SOCKETS = Path("/proc/net/unix")


def bus_name(interface: str, channel: str, options: Mapping[str, Any]) -> str:
    """Name of a bus in messages and of its socket: `socketcan:can0`."""
    port = options.get("port", MULTICAST_PORT if interface == _EMULATED else None)
    return f"{interface}:{channel}" + (f":{port}" if port is not None else "")


def stays_on_host(interface: str, channel: str, options: Mapping[str, Any]) -> bool:
    """Whether a bus is multicast within this host only: its hop limit is 0, or it is emulated here."""
    if interface != _EMULATED:
        return False
    return options.get("hop_limit") == 0 or is_emulated(bus_name(interface, channel, options))


class Mark:
    """Marks a bus as emulated by this process.

    Args:
        name: name of the bus, as `bus_name` gives it.
        bitrate: bit rate of the bus, in bit/s.
    """

    def __init__(self, name: str, bitrate: int) -> None:
        self._sockets = [socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
        for marked, text in zip(self._sockets, (name, f"{name}{_AT}{bitrate}"), strict=True):
            with contextlib.suppress(OSError):
                marked.bind(_address(text))

    def close(self) -> None:
        """Take the mark away. Idempotent."""
        for marked in self._sockets:
            marked.close()


def is_emulated(name: str) -> bool:
    """Whether a running process emulates the bus of this name; False for every bus of an adapter."""
    if not name.startswith(f"{_EMULATED}:"):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_address(name))
        except OSError:
            return False
    return True


class Emulation:
    """Detects that the emulation of a bus has ended; daemons of devices on it end then.

    Args:
        name: name of the bus, as `bus_name` gives it.
        known: True if an earlier check has found it emulated.

    Attributes:
        known: True if it was emulated when this was made, or is known to have been.
    """

    def __init__(self, name: str, *, known: bool = False) -> None:
        self._name = name
        self.known = known or is_emulated(name)

    def is_over(self) -> bool:
        """Whether the emulator of the bus has ended; False for a bus that was not emulated."""
        return self.known and not is_emulated(self._name)


def bitrate_of(name: str) -> int | None:
    """Bit rate of an emulated bus, bit/s; None if no running process emulates one of this name."""
    for bitrate in abstract_names(f"{_address(name)[1:]}{_AT}"):
        return int(bitrate)
    return None


def abstract_names(beginning: str) -> list[str]:
    """The parts after `beginning` of the abstract socket names of this machine, each once."""
    try:
        lines = _SOCKETS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    parts = (line.partition(f"@{beginning}") for line in lines)
    return sorted({end for _, found, end in parts if found})


def _address(name: str) -> str:
    return f"\0hil-emulated {name}"
