"""`hil info`: versions for a bug report."""

from __future__ import annotations

import json
import platform
from importlib import metadata, util

import click

from hil import __version__

_PACKAGES = (
    "numpy", "scipy", "numba", "pydantic", "click", "dynamixel-sdk", "pyserial", "python-can", "cantools",
    "fastcrc", "filterpy", "mcap", "rosbags", "matplotlib", "rerun-sdk", "pyarrow", "pyrealsense2",
)  # fmt: skip
_EXTRAS = {
    "fast": "numba",
    "rerun": "rerun",
    "parquet": "pyarrow",
    "t265": "pyrealsense2",
    "campaign": "distributed",
}


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "absent"


@click.command()
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(as_json: bool) -> int:
    """Print the versions that matter for a bug report."""
    packages = {name: _version(name) for name in _PACKAGES}
    extras = {name: util.find_spec(module) is not None for name, module in _EXTRAS.items()}
    host = platform.platform()
    if as_json:
        found = {"hil": __version__, "python": platform.python_version(), "platform": host}
        click.echo(json.dumps({**found, "packages": packages, "extras": extras}))
        return 0
    click.echo(f"hil {__version__}, Python {platform.python_version()}, {host}")
    for name, version in packages.items():
        click.echo(f"  {name:16} {version}")
    click.echo("extras: " + ", ".join(f"{n} ({'yes' if there else 'no'})" for n, there in extras.items()))
    return 0
