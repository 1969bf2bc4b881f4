"""`hil emulate`: serve the emulated devices to any client until SIGINT or SIGTERM.

Serial ports that a bench file names become links to the terminals where its devices are served.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.closed_output import Answered
from hil.cli.options import FILE, OUT
from hil.config.bench import BenchConfig
from hil.core.clock import sleep_punctually
from hil.core.errors import EXIT_PASS, UsageError, reason_of
from hil.core.registry import kinds
from hil.support.interrupt_signals import handled_by

_OF_HARDWARE = Path("/dev")
_TERMINALS = "/dev/pts/"
_NICE = -5
_PATIENCE_S = 60.0


class PortLinks:
    """Links from the port names in a bench file to the PTYs, whose own names change with every start.

    Args:
        config: the bench.
        endpoints: endpoints of its emulated devices, by the name they are shown as.
        of_hardware: True to link names below `/dev`, the place of real ports, as well.
    """

    def __init__(
        self, config: BenchConfig, endpoints: Mapping[str, Mapping[str, Any]], *, of_hardware: bool = False
    ) -> None:
        self._made: dict[Path, str] = {}
        self._wanted = {}
        for name in config.emulated():
            table = config.devices()[name]
            served = endpoints.get(kinds()[name].shown_as, {}).get("port")
            port = getattr(table, "port", None) if "port" in table.model_fields_set else None
            if not isinstance(port, str) or not isinstance(served, str) or ":" in port:
                continue
            if of_hardware or not Path(port).absolute().is_relative_to(_OF_HARDWARE):
                self._wanted[name] = (Path(port), served)

    def make(self) -> list[str]:
        """Make the links; returns one line for each that cannot be made.

        An existing file is left alone, except a link to a PTY that is gone because its emulator was killed.
        """
        return [
            f"{name}: {path} {why}; served at {served}"
            for name, (path, served) in self._wanted.items()
            if (why := self._link(path, served))
        ]

    def _link(self, path: Path, served: str) -> str:
        with suppress(OSError):
            if os.readlink(path).startswith(_TERMINALS) and not path.exists():
                path.unlink()
        try:
            path.symlink_to(served)
        except FileExistsError:
            return "is there already and is left alone"
        except OSError as error:
            return f"cannot be made ({reason_of(error)})"
        self._made[path] = served
        return ""

    def remove(self) -> None:
        """Remove the links that were made, unless another program has replaced them."""
        for path, served in self._made.items():
            with suppress(OSError):
                if os.readlink(path) == served:
                    path.unlink()
        self._made.clear()


if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hil.bench.hold.emulated_support import EmulatedSupport
    from hil.cli.emulate import PortLinks


@click.command()
@bench_options("bench")
@click.option("--only", default="", metavar="NAMES", help="Devices, separated by commas [default: all].")
@bench_options("seed", "faults")
@click.option(
    "--standard-ports",
    is_flag=True,
    help="Motion capture at Motive's ports 1510 and 1511, CAN buses at python-can's own group and port.",
)
@click.option(
    "--out", type=OUT, help="Write the line here as well, once everything answers; removed at the end."
)
@click.option(
    "--wait",
    "awaited",
    type=FILE,
    metavar="FILE",
    help="Serve nothing: wait until another emulator has put FILE there by --out, print it, end.",
)
@click.option("--lifeline", is_flag=True, help="End as well when standard input is closed.")
@click.option("--json", is_flag=True, expose_value=False, hidden=True, help="The line is JSON in any case.")
@click.option("--await-start", is_flag=True, help="World time stands still until a byte on standard input.")
def command(
    request: BenchRequest,
    only: str,
    standard_ports: bool,
    out: Path | None,
    awaited: Path | None,
    lifeline: bool,
    await_start: bool,
) -> int:
    """Serve emulated devices on PTYs, a CAN interface and loopback UDP.

    Prints one JSON line of endpoints on stdout, then runs until SIGINT or SIGTERM and ends with 0.
    Devices that the bench file calls real are emulated as well when they are named with --only.

    With --out the line also appears, whole, as a file once every device answers; what an earlier run left
    there is removed at the start, and the file is removed again when the emulator ends in order. In a script
    put `hil emulate --wait FILE` between an emulator in the background and its first client.

    A robot on a wall is held by hand until a client enables torque, and slides without it from then on: the
    first line on stderr says so, the last one whether it is held, and how far it is from where it began.

    Motion capture is served at [mocap] command_port and data_port where the bench file names them, else
    at free ports; it streams to [mocap] multicast, or to each client. With --standard-ports clients of
    Motive's multicast group are served beside them. Nothing leaves this host.

    A serial port that the bench file names becomes a link to the terminal that serves the device, below
    /dev with --standard-ports only; what is there already is left alone. A CAN bus with
    interface = "udp_multicast" is served at its own group and port.

    Example: hil emulate --only servos,imu --out endpoints.json
    """
    from hil.bench import open_emulation
    from hil.bench.endpoints_file import EndpointsFile, await_endpoints
    from hil.bench.hold.emulated_support import EmulatedSupport
    from hil.cli.emulate import PortLinks
    from hil.config.loading import NoSuchDevice, load_bench
    from hil.config.several_devices import resolve_device

    if awaited is not None:
        click.echo(await_endpoints(awaited, _PATIENCE_S), nl=False)
        return EXIT_PASS
    file = EndpointsFile(out) if out is not None else None
    said = tuple(filter(None, only.split(",")))
    try:
        config = load_bench(request.bench, emulate=said or ("all",))
    except NoSuchDevice as error:
        raise UsageError(
            f"--only {error.device}: the bench has no such device",
            expected="some of " + ", ".join(error.present),
            remedy=error.remedy,
        ) from None
    names = tuple(resolve_device(word, config.labels()) for word in said)
    descriptor = sys.stdin.fileno() if lifeline or await_start else None
    server = open_emulation(
        config,
        only=names,
        seed=request.seed,
        faults=request.faults,
        lifeline=descriptor,
        await_start=await_start,
        standard_ports=standard_ports,
    )

    endpoints = server.endpoints()
    line = json.dumps(endpoints)
    nothing = contextlib.nullcontext()
    robot = (
        nothing
        if await_start
        else _hold_reported(EmulatedSupport(config, server.world, "servos" in server.transports))
    )  # the caller that awaits the start reports it
    links, first = PortLinks(config, endpoints, of_hardware=standard_ports), config.loop.fifo_priority
    ending = _ended_by_signals(server.stop, only_by_sigterm=await_start)
    with ending, _as_prompt_as_hardware(first), robot, file or nothing, _linked(links):
        _answer(line)
        server.run(ready=partial(file.write, line) if file is not None else None)
    return EXIT_PASS


def _ended_by_signals(
    stop: Callable[[], None], *, only_by_sigterm: bool
) -> contextlib.AbstractContextManager[None]:
    """Context in which a signal ends the server in an orderly way.

    Args:
        stop: function that ends the server.
        only_by_sigterm: True to ignore SIGINT and SIGHUP: a terminal also sends them to the bench that
            started this process and that has to hold its robot first.
    """

    def leave(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM or not only_by_sigterm:
            stop()

    return handled_by(leave)


@contextlib.contextmanager
def _hold_reported(robot: EmulatedSupport) -> Iterator[None]:
    """Print on stderr how the robot is held on its wall, at the start and at the end of the block."""
    if reported := robot.at_the_start():
        click.echo(reported, err=True)
    try:
        yield
    finally:
        if reported := robot.at_the_end():
            click.echo(reported, err=True)


@contextlib.contextmanager
def _linked(links: PortLinks) -> Iterator[None]:
    """Context in which ports of the bench file link to PTYs; a link that fails is reported on stderr."""
    for reported in links.make():
        click.echo(reported, err=True)
    try:
        yield
    finally:
        links.remove()


def _answer(line: str) -> None:
    """Print the line on stdout and flush; a later error adds no JSON object."""
    click.echo(line)
    sys.stdout.flush()
    if (answered := click.get_current_context().find_object(Answered)) is not None:
        answered.already = True


@contextlib.contextmanager
def _as_prompt_as_hardware(fifo_priority: int | None) -> Iterator[None]:
    """Context with high priority, where allowed, and short garbage collections, for prompt answers."""
    sleep_punctually()
    with contextlib.suppress(OSError):
        os.nice(_NICE)
        if fifo_priority is not None:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo_priority))
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
