"""Versions of the software that a recording or a result depends on."""

import hashlib
import os
import platform
import re
from functools import cache
from importlib import metadata
from pathlib import Path

import hil

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "dynamixel-sdk",
    "pyserial",
    "python-can",
    "cantools",
    "filterpy",
    "mcap",
    "mujoco",
)


ABSENT = "absent"
"""Word in place of the version of a package that is not installed."""


def version_of(package: str) -> str:
    """Version of an installed package, else `absent`.

    It is searched in its metadata: to parse these, for fifty packages, takes a tenth of a second.
    """
    try:
        installed = metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return ABSENT
    found = re.search(r"^Version: *(\S+)", installed.read_text("METADATA") or "", re.MULTILINE)
    return found[1] if found else installed.version


@cache
def versions() -> dict[str, str]:
    """Package name to version, `absent` if not installed; `hil_sources` distinguishes working copies."""
    return {
        "hil": hil.__version__,
        "hil_sources": _sources(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{package: version_of(package) for package in _PACKAGES},
    }


def make() -> dict[str, str]:
    """Versions that determine the bits of a result: Python, this package and those that it depends on."""
    found = {name: version for name, version in versions().items() if name != "platform"}
    return found | {"python": ".".join(platform.python_version_tuple()[:2])}


def _sources() -> str:
    """Digest of the package's own source files, the procedures among them: in a checkout they are a link."""
    folder = Path(hil.__file__).parent
    found = [Path(at, name) for at, _, names in os.walk(folder, followlinks=True) for name in names]
    digest = hashlib.sha256()
    for path in sorted(path for path in found if path.suffix == ".py"):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
