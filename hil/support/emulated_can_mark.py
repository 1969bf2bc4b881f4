"""Marks a CAN bus as emulated while the emulating process lives, by a name in the kernel.

Who keeps a fan running must outlive everything but the fan itself. A real fan outlives every program, an
emulated one ends with its emulator. The name is in Linux' abstract space; elsewhere no bus is marked. Any
user of the machine can take a name there, so a mark counts for the buses that are emulated, multicast groups,
and never for an adapter: nothing ends the daemon of a real fan by it.

Where the emulated bus has no bit rate on its way, as multicast has none, a second name says which it has.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

MULTICAST_PORT = 43113
"""Where python-can's `udp_multicast` is when no port is named."""
_EMULATED = "udp_multicast"
_AT = ", bit/s: "
_SOCKETS = Path("/proc/net/unix")


def bus_name(interface: str, channel: str, options: Mapping[str, Any]) -> str:
    """A bus as messages and sockets call it: `socketcan:can0`."""
    port = options.get("port", MULTICAST_PORT if interface == _EMULATED else None)
    return f"{interface}:{channel}" + (f":{port}" if port is not None else "")


def stays_on_host(interface: str, channel: str, options: Mapping[str, Any]) -> bool:
    """Whether a multicast bus is of this host only: nothing goes over a hop, or it is emulated here."""
    if interface != _EMULATED:
        return False
    return options.get("hop_limit") == 0 or is_emulated(bus_name(interface, channel, options))


class Mark:
    """Marks a bus as emulated by this process.

    Args:
        name: as `bus_name` gives it.
        bitrate: of the bus, in bit/s.
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
    """Whether a living process emulates the bus of this name; never one of an adapter."""
    if not name.startswith(f"{_EMULATED}:"):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_address(name))
        except OSError:
            return False
    return True


class Emulation:
    """Whether a bus was emulated, and no longer is. Daemons of devices there end then.

    Args:
        name: as `bus_name` gives it.
        known: whether an earlier look has found that it is emulated.

    Attributes:
        known: whether it was emulated when this was made, or is known to have been.
    """

    def __init__(self, name: str, *, known: bool = False) -> None:
        self._name = name
        self.known = known or is_emulated(name)

    def is_over(self) -> bool:
        """Whether its emulator has ended; never for a bus that was not emulated."""
        return self.known and not is_emulated(self._name)


def bitrate_of(name: str) -> int | None:
    """Bit rate of an emulated bus, bit/s; None where no living process emulates one of this name."""
    for bitrate in abstract_names(f"{_address(name)[1:]}{_AT}"):
        return int(bitrate)
    return None


def abstract_names(beginning: str) -> list[str]:
    """What follows `beginning` in the names of this machine's sockets in the abstract space, each once."""
    try:
        lines = _SOCKETS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    parts = (line.partition(f"@{beginning}") for line in lines)
    return sorted({end for _, found, end in parts if found})


def _address(name: str) -> str:
    return f"\0hil-emulated {name}"
