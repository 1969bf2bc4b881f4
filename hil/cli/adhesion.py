"""`hil adhesion`: switches the fan that presses the robot on its wall, shows it, runs its daemon."""

from __future__ import annotations

import json
import os
import sys
import time
from typing import TYPE_CHECKING

import click

from hil.cli.completion_types import BENCH
from hil.cli.options import JSON, FiniteRange, SuggestingGroup
from hil.core.errors import EXIT_DEVICE, EXIT_PASS, DeviceError, UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hil.bench.fan_commands import Spec, Status
    from hil.config.bench import BenchConfig

_BENCH = click.option("--bench", type=BENCH, required=True, help="Bench file of the robot.")
_TETHERED = click.option(
    "--tethered", is_flag=True, help="The robot is tethered, or off the wall: you have looked."
)


@click.group(cls=SuggestingGroup)
def command() -> None:
    """The fan that presses the robot on its wall, and the daemon that keeps it running.

    The fan keeps running when a program ends, however it ends: a separate process, the fan daemon, keeps
    commanding it. Only `hil adhesion off` stops it. While the robot may hang by the fan, `off` and a lower
    force from `on` are refused, unless --tethered confirms that you have looked.
    """


@command.command("on")
@_BENCH
@click.option(
    "--force",
    "force_n",
    type=FiniteRange(0.0, 500.0, min_open=True),
    help="N [default: the bench file's force on its wall].",
)
@click.option("--duty", type=FiniteRange(0.0, 1.0, min_open=True), help="Share of the voltage, not a force.")
@click.option(
    "--wait",
    "wait_s",
    type=FiniteRange(0.0, 120.0),
    default=15.0,
    show_default=True,
    help="Seconds that it may take to get there.",
)
@_TETHERED
@JSON
def switch_on(
    bench: str, force_n: float | None, duty: float | None, wait_s: float, tethered: bool, as_json: bool
) -> int:
    """Start the fan, or change the set-point of a running one, along a ramp; it stays on.

    A force below the present one, or too small to hold this robot on this surface, is refused unless
    --tethered is given, or IMU and load cells both show that the robot does not hang by the fan. A fan that a
    running bench commands is refused, too.

    Example: hil adhesion on --bench my.toml
    """
    from hil.bench import fan_commands

    if force_n is not None and duty is not None:
        raise UsageError("--force and --duty are both given", expected="one of them", remedy="leave one out")
    config = _config(bench)
    spec = fan_commands.daemon_spec(config)
    reached_n = fan_commands.switch_on(
        config, force_n=force_n, duty=duty, wait_s=wait_s, say=_progress, tethered=tethered
    )
    status = fan_commands.daemon_status(spec)
    if as_json:
        click.echo(json.dumps({"fan": spec.name, "force_n": reached_n, "daemon": status}))
    else:
        click.echo(f"{spec.name}: good for {reached_n:.1f} N; it stays on until `hil adhesion off`")
    return EXIT_PASS


@command.command("off")
@_BENCH
@_TETHERED
@JSON
def switch_off(bench: str, tethered: bool, as_json: bool) -> int:
    """Stop the fan, and propellers that have a daemon, along a ramp.

    Refused unless --tethered is given, or IMU and load cells both show that the robot does not hang by it.

    Example: hil adhesion off --bench my.toml --tethered
    """
    from hil.bench import fan_commands
    from hil.bench.fan_interlock import seen_off_the_wall

    config = _config(bench)
    specs = fan_commands.daemon_specs(config)
    why = "the operator: tethered or off the wall" if tethered else seen_off_the_wall(config)
    found = {kind: fan_commands.switch_off(spec, why, say=_progress) for kind, spec in specs.items()}
    kind, spec = next(iter(specs.items()))
    if found[kind] is None and (others := fan_commands.other_daemons(specs.values())):
        raise DeviceError(
            kind,
            "it has no daemon and was not stopped; a daemon on its bus commands " + "; ".join(others),
            port=spec.name,
            expected="the one that runs",
            remedy=f"name that one in [{kind}] of {bench}",
        )
    if as_json:
        click.echo(json.dumps({**_as_json(specs, found), "confirmed_by": why}))
        return EXIT_PASS
    for kind, spec in specs.items():
        status, message = found[kind], "it has no daemon; nothing was running that could be stopped"
        if status is not None:
            message = f"off ({why})" + (
                f", by the daemon{other}" if (other := fan_commands.of_whom(status)) else ""
            )
        click.echo(f"{spec.name}: {message}")
    return EXIT_PASS


@command.command("status")
@_BENCH
@JSON
def show_status(bench: str, as_json: bool) -> int:
    """Show fan, propellers and their daemons; ends with 3 if a daemon is missing or does not answer.

    Example: hil adhesion status --bench my.toml
    """
    from hil.bench import fan_commands

    specs = fan_commands.daemon_specs(_config(bench))
    found = {kind: _status(spec) for kind, spec in specs.items()}
    if as_json:
        click.echo(json.dumps(_as_json(specs, found)))
    else:
        for kind, spec in specs.items():
            _show(spec, found[kind])
    return _exit_code(found)


def _status(spec: Spec) -> Status | DeviceError | None:
    """Status of a daemon, its error if it rejects the request, None without a daemon."""
    from hil.bench import fan_commands

    try:
        return fan_commands.daemon_status(spec)
    except DeviceError as error:
        return error


def _exit_code(found: Mapping[str, Status | DeviceError | None]) -> int:
    """0 if a daemon answers for each device that holds the robot; else 3, with the reason on stderr."""
    code = EXIT_PASS
    for kind, status in found.items():
        if status is None or isinstance(status, DeviceError):
            code, message = EXIT_DEVICE, status or f"{kind} has no daemon: nothing commands it now"
            click.echo(f"hil: {message}", err=True)
    return code


def _as_json(
    specs: Mapping[str, Spec], found: Mapping[str, Status | DeviceError | None]
) -> dict[str, object]:
    """The daemons' states for `--json`: the fan as `fan` and `daemon`, propellers by their kind."""
    plain = {kind: None if isinstance(status, DeviceError) else status for kind, status in found.items()}
    own = {kind: {"name": spec.name, "daemon": plain[kind]} for kind, spec in specs.items()}
    fan = own.pop("adhesion", None)
    return {**({} if fan is None else {"fan": fan["name"], "daemon": fan["daemon"]}), **own}


def _how(spec: Spec, status: Status | DeviceError | None) -> str:
    """State of the fan or propellers of `spec` in words."""
    from hil.bench import fan_commands

    if isinstance(status, DeviceError):
        return "its daemon refuses to report its state"
    return "no daemon" if status is None else fan_commands.described(status, spec)


def _show(spec: Spec, status: Status | DeviceError | None) -> None:
    from hil.bench import fan_commands

    message = f"{spec.name}: {_how(spec, status)}"
    if status is None:
        starter = "`hil adhesion on`" if spec.device == "adhesion" else "`hil run`"
        message += f"; {starter} starts one"
    click.echo(message)
    if status is None or isinstance(status, DeviceError):
        return
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(status["since"]))
    behind = f"process {status['standby']}" if status["standby"] else "none"
    click.echo(
        f"daemon: process {status['pid']}{fan_commands.of_whom(status)} since {since}, standby: {behind}"
    )
    click.echo(f"log: {status['log'] or 'that of its service'}")


@command.command("watch")
@_BENCH
@click.option(
    "--every",
    "every_s",
    type=FiniteRange(0.1, 60.0),
    default=1.0,
    show_default=True,
    help="Seconds between two lines.",
)
@click.option(
    "--duration",
    "duration_s",
    type=FiniteRange(0.0, min_open=True),
    help="Seconds [default: until interrupted].",
)
def watch(bench: str, every_s: float, duration_s: float | None) -> int:
    """Print a line about fan and propellers at a fixed interval. Ending this does not affect them.

    Example: hil adhesion watch --bench my.toml
    """
    from hil.bench import fan_commands

    specs = fan_commands.daemon_specs(_config(bench))
    end_s = None if duration_s is None else time.monotonic() + duration_s
    while True:
        found = {kind: _status(spec) for kind, spec in specs.items()}
        for kind, status in found.items():
            which = f"{kind}: " if len(specs) > 1 else ""
            click.echo(f"{time.strftime('%H:%M:%S')} {which}{_how(specs[kind], status)}")
        if end_s is not None and time.monotonic() + every_s > end_s:
            return _exit_code(found)
        time.sleep(every_s)


@command.command("keep")
@_BENCH
@click.option("--propellers", is_flag=True, help="Run the daemon of the propellers on VESCs, not the fan's.")
def keep(bench: str, propellers: bool) -> int:
    """Run the fan daemon in the foreground: for a service of the robot's computer.

    Takes over a running fan, else waits for a request. Ignores every signal that can be caught.

    Example: hil adhesion keep --bench my.toml
    """
    from hil.bench import fan_commands

    specs = fan_commands.daemon_specs(_config(bench))
    if (spec := specs.get("thrust" if propellers else "adhesion")) is None:
        missing, wanted = ("propellers", "propellers on VESCs") if propellers else ("fan", "a fan on CAN")
        raise UsageError(
            f"{bench} has no {missing} that a daemon could run",
            expected=f"{wanted}, not emulated here",
            remedy="leave out --propellers" if propellers else "add [adhesion] to the bench file",
        )
    if fan_commands.daemon_status(spec) is not None:
        raise UsageError(
            f"{spec.name} has a daemon already", remedy="`hil adhesion status` names its process"
        )
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, fan_commands.daemon_command(spec))


def _config(bench: str) -> BenchConfig:
    from hil.config.loading import load_bench

    return load_bench(bench)


def _progress(text: str) -> None:
    click.echo(text, err=True)
