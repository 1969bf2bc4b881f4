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

_NICE = -5


@click.command()
@click.option("--bench", default="emulated", show_default=True, help="Bench file or profile name.")
@click.option("--only", default="", help="Comma-separated device names; default: all of the bench.")
@click.option("--seed", default=0, show_default=True, help="Seed of the emulated world.")
@click.option("--fault", "faults", multiple=True, help="Fault, for example imu:stuck@2+3 (repeatable).")
@click.option("--lifeline", is_flag=True, hidden=True, help="End when standard input is closed.")
def command(bench: str, only: str, seed: int, faults: tuple[str, ...], lifeline: bool) -> int:
    """Serve emulated devices on PTYs, a CAN interface and loopback UDP.

    Prints one JSON line of endpoints on stdout, then runs until SIGINT or SIGTERM. Devices that the
    bench file calls real are emulated as well when they are named with --only.
    """
    from hil.bench import open_emulation
    from hil.config.bench import load_bench

    names = tuple(n for n in only.split(",") if n)
    config = load_bench(bench, emulate=names or ("all",))
    descriptor = sys.stdin.fileno() if lifeline else None
    server = open_emulation(config, only=names, seed=seed, faults=faults, lifeline=descriptor)

    def leave(signum: int, frame: FrameType | None) -> None:
        server.stop()

    signal.signal(signal.SIGINT, leave)
    signal.signal(signal.SIGTERM, leave)
    click.echo(json.dumps(server.endpoints()))
    sys.stdout.flush()
    _as_prompt_as_hardware()
    server.run()
    return 0


def _as_prompt_as_hardware() -> None:
    """Hardware does not wait for a busy host: go first where that is allowed, and keep collections short."""
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    gc.collect()
    gc.freeze()
