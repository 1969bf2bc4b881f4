"""`hil info`: versions and devices for a bug report; compiles the numerical kernels on request."""

import json
import logging
import platform
import signal
from collections.abc import Callable
from functools import partial
from types import FrameType

import click

from hil import __version__
from hil.cli import declared
from hil.cli.options import JSON
from hil.cli.progress import reporting
from hil.core.errors import EXIT_PASS, EXIT_USAGE, Aborted, HilError
from hil.support.arithmetic_fingerprint import fingerprint
from hil.support.extras import MODULES, packages, why_unusable
from hil.support.interrupt_signals import handled_by
from hil.support.progress import Report
from hil.support.versions import version_of

_COMPILING = "compiling numerical kernels"
_ROUNDS = ({"filter": 55, "calibration": 3}, {"own": 24, "unscented filter": 4, "smoother": 12, "mujoco": 2})
"""Parts of the kernels, each with the share of the waiting time, %, by whose end it is ready."""


def _load_bench(plant: str) -> None:
    from hil.bench import open_bench
    from hil.robot.trajectories import line

    with open_bench("emulated", overrides={"emulation.plant": plant}) as bench:
        bench.observe(0.1, feedback="ekf")
        bench.make_pipeline(line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)))


def _load(part: str) -> None:
    """Compile the kernels of a part, or load them if they are in the cache."""
    from hil.calibration.residual_pass import load_pass
    from hil.config.estimator import EstimatorConfig
    from hil.estimator.fusion import load_filter
    from hil.estimator.sigma_points import points_of
    from hil.estimator.smoother import load_smoother
    from hil.support.numba_jit import PROGRESS

    PROGRESS.setLevel(logging.ERROR)  # the command reports its own progress
    loads: dict[str, Callable[[], None]] = {
        "filter": load_filter,
        "unscented filter": lambda: load_filter(points_of(EstimatorConfig(kind="ukf"))),
        "smoother": load_smoother,
        "calibration": load_pass,
    }
    loads.get(part, partial(_load_bench, part))()


def _end(number: int, _frame: FrameType | None) -> None:
    """End the processes that compile before this one, which would leave them to themselves."""
    raise Aborted(f"ended by {signal.Signals(number).name}; what is compiled is kept")


def _compile(report: Report) -> None:
    """Compile all kernels in two processes, those that others contain first."""
    from hil.procedure.worker_processes import Workers

    lacking = ["mujoco"] if why_unusable("mujoco") else []
    rounds = [{part: share for part, share in one.items() if part not in lacking} for one in _ROUNDS]
    done, total = 0, sum(sum(one.values()) for one in rounds)
    report(_COMPILING, done, total)
    with handled_by(_end), Workers(2) as workers:
        for one in rounds:
            for share, _ in zip(one.values(), workers.at_once(_load, [*one]), strict=True):
                done += share
                report(_COMPILING, done, total)


def _devices() -> dict[str, list[dict[str, str]]]:
    """Models of every kind of device, each with its title and the package that it comes from."""
    return {
        name: [{"model": m.name, "title": m.title, "package": m.package} for m in kind.models]
        for name, kind in declared.devices().items()
    }


@click.command()
@click.option("--compile", "compiling", is_flag=True, help="First compile all numerical kernels.")
@JSON
def command(compiling: bool, as_json: bool) -> int:
    """Print the versions that matter for a bug report, and the devices that a bench file may name.

    Ends with 2 when an installed package adds a device that cannot be used.

    With --compile the machine code of estimators, smoother, calibration and emulated wall is made now, in two
    processes (up to a minute, once for each version), instead of at the start of the first run.

    Example: hil info --json
    """
    if compiling:
        with reporting(quiet=as_json) as report:
            _compile(report)
    found = {name: version_of(name) for name in packages()}
    missing = {name: why_unusable(name) for name in MODULES}
    host = platform.platform()
    devices, problem = dict[str, list[dict[str, str]]](), ""
    try:
        devices = _devices()
    except HilError as error:
        problem = str(error)
    code = EXIT_USAGE if problem else EXIT_PASS
    arithmetic = fingerprint()
    if as_json:
        ours = {"hil": __version__, "python": platform.python_version(), "platform": host}
        usable = {name: not why for name, why in missing.items()}
        lacking = {"extras_lack": {name: why for name, why in missing.items() if why}}
        reported = {**lacking, "devices": devices, **({"problem": problem} if problem else {})}
        computes = {"packages": found, "arithmetic": arithmetic}
        click.echo(json.dumps({**ours, **computes, "extras": usable, **reported}))
        return code
    click.echo(f"hil {__version__}, Python {platform.python_version()}, {host}")
    for name, version in found.items():
        click.echo(f"  {name:16} {version}")
    click.echo("arithmetic:")
    for name, value in arithmetic.items():
        click.echo(f"  {name:16} {value}")
    click.echo("extras:")
    for name, why in missing.items():
        click.echo(f"  {name:16} {f'no: {why}' if why else 'yes'}")
    click.echo("devices:" if devices else f"devices: {problem}")
    for kind, models in devices.items():
        for model in models:
            origin = f" ({model['package']})" if model["package"] != "hil" else ""
            click.echo(f"  {kind:16} {model['model']:12} {model['title']}{origin}")
    return code
