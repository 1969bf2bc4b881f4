"""Sources of the answers to a command's questions: a person, a file, or another program."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli import progress
from hil.cli.options import FileName
from hil.core.errors import UsageError

if TYPE_CHECKING:
    from hil.bench.by_hand import Hand
    from hil.config.bench import BenchConfig
    from hil.core.interfaces import Sink
    from hil.procedure.interrupts import Interrupts
    from hil.procedure.operator import Operator

answers_option = click.option(
    "--answers",
    type=FileName(path_type=Path, allow_dash=True),
    help="File that answers the operator's prompts; - for lines of stdin, as they are asked for.",
)


def operator(answers: Path | None) -> Operator:
    """The source of answers: a person at the terminal, the lines of stdin for `-`, a file.

    Raises:
        ConfigError: the file cannot be read.
    """
    from hil.procedure.operator import Answers, Lines, Terminal

    if answers is None:
        return Terminal()
    if str(answers) != "-":
        return Answers(answers)
    return Lines(progress.tell if progress.for_a_program() else _say)


def _say(kind: str, text: str) -> None:
    if kind == "question":
        click.echo(text, err=True)


class _TerminalHand:
    """The person at the terminal, who is asked while the bench goes on."""

    def say(self, text: str) -> None:
        """Print what to do on stderr."""
        click.echo(f"hil: NOW: {text}", err=True)

    def has_done(self) -> bool:
        """Whether a line was entered since the last call."""
        done = False
        while select.select([sys.stdin], [], [], 0.0)[0] and os.read(sys.stdin.fileno(), 4096):
            done = True
        return done


def at_the_terminal() -> Hand:
    """The person at the terminal, for faults by hand; raises `UsageError` without a terminal."""
    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError(
            "--by-hand asks a person, and standard input is no terminal",
            remedy="start it in a terminal; `silent` with --inject-real needs nobody",
        )
    return _TerminalHand()


def asked_to_end() -> Interrupts:
    """Signal handling: a person's Ctrl-C gives the step a moment to end, SIGINT of a program all its time."""
    from hil.procedure.interrupts import PATIENCE_S, Interrupts
    from hil.procedure.operator import tell

    return Interrupts(tell, None if progress.for_a_program() else PATIENCE_S)


def watching(*, table: bool = False) -> tuple[Callable[[BenchConfig], Sink], ...]:
    """Makers of the sinks that report a running bench to a program that reads the progress; else none.

    Args:
        table: True to show the same figures to a person, where standard error is a terminal.
    """
    table = table and sys.stderr.isatty()
    if not (table or progress.for_a_program()):
        return ()
    from hil.bench.third_party.call_timeout import with_time_limit
    from hil.cli.live_table import LiveTable
    from hil.core.clock import MonotonicClock
    from hil.monitor.status_stream import StatusStream

    if progress.for_a_program():
        return (partial(StatusStream, progress.tell, MonotonicClock(), limited=with_time_limit),)
    return (partial(LiveTable, sys.stderr, MonotonicClock(), limited=with_time_limit),)
