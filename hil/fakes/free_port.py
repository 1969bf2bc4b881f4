"""Finds free UDP and TCP ports of this host."""

from __future__ import annotations

import socket


def free_udp_port(host: str = "127.0.0.1") -> int:
    """A UDP port number that is free now; raises `OSError` for an address that is not local."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((host, 0))
        number: int = probe.getsockname()[1]
        return number
