"""Versions of the software that a recording or a result depends on."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

import hil

_PACKAGES = ("numpy", "scipy", "numba", "dynamixel-sdk", "pyserial", "python-can", "filterpy")


@cache
def versions() -> dict[str, str]:
    """Package name to version, `absent` if not installed; `hil_sources` tells working copies apart."""
    found = {
        "hil": hil.__version__,
        "hil_sources": _sources(),
        "python": platform.python_version(),
        "platform": sys.platform,
    }
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


def _sources() -> str:
    """Digest of the package's own source files."""
    folder = Path(hil.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
