"""`hil emulate`: serve the emulated devices to any client until SIGINT or SIGTERM."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
from types import FrameType

import click

from hil.cli.options import SEED
from hil.clock import sleep_punctually
from hil.errors import EXIT_PASS

_NICE = -5
_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command()
@click.option("--bench", default="emulated", show_default=True, help="Bench file or profile name.")
@click.option("--only", default="", metavar="NAMES", help="Devices, separated by commas [default: all].")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the emulated world.")
@click.option("--fault", "faults", multiple=True, help="Fault, for example imu:stuck@2+3 (repeatable).")
@click.option("--lifeline", is_flag=True, help="End as well when standard input is closed.")
@click.option("--json", is_flag=True, expose_value=False, hidden=True, help="The line is JSON in any case.")
@click.option("--await-start", is_flag=True, help="World time stands still until a byte on standard input.")
def command(
    bench: str, only: str, seed: int, faults: tuple[str, ...], lifeline: bool, await_start: bool
) -> int:
    """Serve emulated devices on PTYs, a CAN interface and loopback UDP.

    Prints one JSON line of endpoints on stdout, then runs until SIGINT or SIGTERM and ends with 0.
    Devices that the bench file calls real are emulated as well when they are named with --only.
    """
    from hil.bench import open_emulation
    from hil.config.bench import load_bench

    names = tuple("encoders" if n == "can" else n for n in only.split(",") if n)
    config = load_bench(bench, emulate=names or ("all",))
    descriptor = sys.stdin.fileno() if lifeline or await_start else None
    server = open_emulation(
        config, only=names, seed=seed, faults=faults, lifeline=descriptor, await_start=await_start
    )

    def leave(signum: int, frame: FrameType | None) -> None:
        server.stop()

    for number in _ENDS:
        signal.signal(number, leave)
    _as_prompt_as_hardware(config.loop.fifo_priority)
    click.echo(json.dumps(server.endpoints()))
    sys.stdout.flush()
    server.run()
    return EXIT_PASS


def _as_prompt_as_hardware(fifo_priority: int | None) -> None:
    """Hardware does not wait for a busy host: go first where that is allowed, and keep collections short."""
    sleep_punctually()
    with contextlib.suppress(OSError):
        os.nice(_NICE)
        if fifo_priority is not None:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo_priority))
    gc.collect()
    gc.freeze()
