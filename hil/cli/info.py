"""`hil info`: versions for a bug report; compiles the numerical kernels ahead of time on request."""

from __future__ import annotations

import json
import platform

import click

from hil import __version__
from hil.vocabulary.extras import MODULES, is_installed
from hil.vocabulary.versions import version_of

_PACKAGES = (
    "numpy", "scipy", "numba", "pydantic", "click", "dynamixel-sdk", "pyserial", "python-can", "cantools",
    "fastcrc", "filterpy", "mcap", "rosbags", "matplotlib", "rerun-sdk", "pyarrow", "pyrealsense2",
)  # fmt: skip


def _compile() -> None:
    """Run everything that numba compiles for a moment."""
    from hil.bench import open_bench
    from hil.replay.comparison import smoothed

    for profile in ("emulated", "emulated_floor"):
        with open_bench(profile) as bench:
            records = bench.observe(0.3, feedback="ekf").records
            bench.observe(0.1, feedback="ukf")
            start = records[0].state
            smoothed(records, bench.config.estimator, bench.geometry, bench.config.environment.kind, start)


@click.command()
@click.option("--compile", "compiling", is_flag=True, help="First compile all numerical kernels.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(compiling: bool, as_json: bool) -> int:
    """Print the versions that matter for a bug report.

    With --compile the machine code of estimators, smoother and emulated wall is made now (about a minute,
    once for each version) instead of at the start of the first run.
    """
    if compiling:
        _compile()
    packages = {name: version_of(name) for name in _PACKAGES}
    extras = {name: is_installed(name) for name in MODULES}
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
