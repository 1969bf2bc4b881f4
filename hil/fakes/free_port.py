"""Finds a free UDP port of this host."""

import socket


def free_udp_port(host: str = "127.0.0.1") -> int:
    """Return a UDP port number that is free now; raises `OSError` if `host` is not a local address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((host, 0))
        number: int = probe.getsockname()[1]
        return number
