"""`hil jog`: one wheel, one steering axis or the body by keyboard or gamepad, while a key is held."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.live import drive, must_be_held, open_aloud, open_recorder, real_time_source
from hil.cli.options import JSON, FiniteRange
from hil.cli.progress import for_a_program
from hil.cli.session_folder import SessionFolder, out_option
from hil.core.errors import EXIT_PASS, Aborted, UsageError
from hil.core.signals import WHEELS

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.live import LivePlan
    from hil.live.held_keys import Keys

_WAYS = {
    "body": "w or s ahead or back, a or d to the left or right, q or e turn",
    "wheel": "w or a forward, s or d back",
    "steer": "w or a counter-clockwise, s or d clockwise",
}


@click.command()
@bench_options("bench", "emulate")
@click.option("--wheel", type=click.Choice(WHEELS), help="Wheel to roll.")
@click.option("--steer", type=click.Choice(WHEELS), help="Steering axis to turn.")
@click.option("--body", is_flag=True, help="The whole robot.")
@click.option("--gamepad", is_flag=True, help="Stick or cross of a gamepad, with its left shoulder held.")
@click.option(
    "--speed",
    "speed_m_s",
    default=0.02,
    show_default=True,
    type=FiniteRange(0.001, 0.1),
    help="Speed of the body, or of a wheel's rim, in m/s.",
)
@click.option(
    "--turn",
    "turn_rad_s",
    default=0.2,
    show_default=True,
    type=FiniteRange(0.01, 1.0),
    help="Rate of a steering axis, or of the body's turn, in rad/s.",
)
@bench_options("calibration", "start_pose", "seed", "faults")
@out_option
@JSON
def command(
    request: BenchRequest,
    wheel: str | None,
    steer: str | None,
    body: bool,
    gamepad: bool,
    speed_m_s: float,
    turn_rad_s: float,
    out: Path | None,
    as_json: bool,
) -> int:
    """Move the robot by keyboard or gamepad, in real time; it stops when the key is let go.

    A key counts as let go when the terminal has not repeated it for 0.15 s, and is ignored after 10 s until
    it is let go. Key x ends the session; so does a terminal that is closed. Limits, checks, the recording in
    out/live and HELD at the end are those of `hil live`. With --gamepad the left shoulder button is held all
    the time, button Back ends the session, and so does a gamepad that is lost.

    Example: hil jog --bench emulated --wheel FL
    """
    from hil.live import LivePlan, LiveSession
    from hil.live.held_keys import LET_GO_S, LOST
    from hil.live.jog import BodyKeys
    from hil.support.interrupt_signals import StopRequest

    if (wheel is not None) + (steer is not None) + body != 1:
        raise UsageError("hil jog moves one thing", expected="one of --wheel NAME, --steer NAME and --body")
    source = real_time_source(request)
    moves = "body" if body else f"wheel {wheel}" if wheel is not None else f"steer {steer}"
    stop, folder = StopRequest(), SessionFolder(out, "jog", moves)
    folder.check()
    click.echo("keys do not count yet; a line will say when", err=True)
    with stop.noted(), _operator(gamepad) as make_keys, closing(open_aloud(source)) as opened:
        keys = make_keys(opened.clock.now_ns)
        if body:
            lines = BodyKeys(keys, speed_m_s, turn_rad_s)
            plan = LivePlan(commands=lines, dead_man_s=LET_GO_S, over=keys.over)
        elif wheel is not None:
            plan = _of_joint(
                opened, keys, f"drive_{wheel}", speed_m_s / float(opened.geometry.radius_m.max())
            )
        else:
            plan = _of_joint(opened, keys, f"steer_{steer}", turn_rad_s)
        recorder = open_recorder(opened, folder.recording, "stop")
        session = LiveSession(opened, plan, recorder=recorder, stop=stop)
        keys.ready = partial(_say_ready, moves)
        drive(session, folder, None, as_json=as_json)
        must_be_held(opened, recorder, stop)
        if keys.ended in LOST:
            raise Aborted(keys.ended)
    return EXIT_PASS


def _say_ready(moves: str, too_early: bool) -> None:
    """Tell the operator that keys count from now on, and whether some came before."""
    if too_early:
        click.echo("keys came while the bench opened: they did not count", err=True)
    click.echo(f"hold a key: {_WAYS[moves.partition(' ')[0]]}; x ends", err=True)


@contextmanager
def _operator(gamepad: bool) -> Iterator[Callable[[Callable[[], int]], Keys]]:
    """Yield what makes the operator's keys on a clock: those of a gamepad, a terminal, or a program."""
    from hil.live.held_keys import HeldKeys, key_by_key

    if gamepad:
        from hil.live.gamepad import Gamepad

        with closing(Gamepad()) as pad:
            click.echo(f"gamepad: {pad.name}; the left shoulder is held all the time, Back ends", err=True)
            yield pad.on
    elif sys.stdin is not None and sys.stdin.isatty():
        terminal = sys.stdin.fileno()
        with key_by_key(terminal):
            yield partial(HeldKeys, terminal)
    elif sys.stdin is not None and for_a_program():
        yield partial(HeldKeys, sys.stdin.fileno())
    else:
        raise UsageError(
            "hil jog reads keys, and standard input is no terminal",
            remedy="start it in a terminal, or give --gamepad; a program sends velocities to `hil live "
            "--command stdin`",
        )


def _of_joint(bench: Bench, keys: Keys, joint: str, rate_rad_s: float) -> LivePlan:
    """The plan by which the keys move one joint of an open bench."""
    from hil.live import LivePlan
    from hil.live.jog import JointJog

    jog = JointJog(joint, keys, rate_rad_s)
    bench.driven_by = (jog.name, jog)
    return LivePlan(program=jog, feedback="odometry", over=keys.over)
