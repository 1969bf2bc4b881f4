"""python-can's `udp_multicast` bus hears every group of the host at its port: here it hears its own alone."""

from __future__ import annotations

import contextlib
import os
import socket

import can

_MULTICAST_ALL = ((socket.IPPROTO_IP, 49), (socket.IPPROTO_IPV6, 29))
"""`IP_MULTICAST_ALL` and `IPV6_MULTICAST_ALL` of Linux (/usr/include/linux/in.h, in6.h)."""


def of_own_group(interface: str, bus: can.BusABC) -> can.BusABC:
    """A bus that has just been opened, which from now on takes frames of the group that it has joined only.

    python-can binds to the port alone, and Linux then passes on whatever group any program of the host has
    joined. What is sent to the port of this host itself, not to a group, still comes through.

    Args:
        interface: of python-can; those that are no multicast are left as they are.
        bus: of that interface; its `fileno` is that of its socket.
    """
    if interface == "udp_multicast":
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            for level, option in _MULTICAST_ALL:
                with contextlib.suppress(OSError):  # the option of the other version of IP, or another system
                    same.setsockopt(level, option, 0)
    return bus
