"""A CAN bus that a process emulates is marked so, for as long as that process lives: by a name in the kernel.

Who keeps a fan running must outlive everything but the fan itself. A real fan outlives every program, an
emulated one ends with its emulator. The name is in Linux' abstract space; elsewhere no bus is marked.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Mapping
from typing import Any

_MULTICAST_PORT = 43113
"""Where python-can's `udp_multicast` is when no port is named."""


def bus_name(interface: str, channel: str, options: Mapping[str, Any]) -> str:
    """A bus as messages and sockets call it: `socketcan:can0`."""
    port = options.get("port", _MULTICAST_PORT if interface == "udp_multicast" else None)
    return f"{interface}:{channel}" + (f":{port}" if port is not None else "")


class Mark:
    """Marks a bus as emulated by this process.

    Args:
        name: as `bus_name` gives it.
    """

    def __init__(self, name: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with contextlib.suppress(OSError):
            self._socket.bind(_address(name))

    def close(self) -> None:
        """Take the mark away. Idempotent."""
        self._socket.close()


def is_emulated(name: str) -> bool:
    """Whether a living process emulates the bus of this name."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_address(name))
        except OSError:
            return False
    return True


def _address(name: str) -> str:
    return f"\0hil-emulated {name}"
