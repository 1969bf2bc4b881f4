"""Versions of the software that a result depends on."""

from __future__ import annotations

import platform
from importlib import metadata

from hil import __version__

_PACKAGES = ("numpy", "scipy", "numba", "dynamixel-sdk", "pyserial", "python-can", "cantools", "mcap")


def versions() -> dict[str, str]:
    """Package name to version, `absent` for what is not installed."""
    found = {"hil": __version__, "python": platform.python_version(), "platform": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found
