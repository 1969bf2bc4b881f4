"""Progress on stderr with the time left: bars on a terminal, elsewhere a line per tenth of the work.

With `--progress json`, before the command, a program reads it: one object per line with one key, `progress`,
`question`, `answered`, `live` or `held`. Every other line is a message.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import PROGRESS
from hil.core.clock import Clock, MonotonicClock, nanoseconds
from hil.support.progress import WHOLE, Pace, Report, in_words, silent

if TYPE_CHECKING:
    from rich.progress import TaskID

_BETWEEN_NS = nanoseconds(0.2)
_QUIET_NS = nanoseconds(30.0)
"""Longest time between two lines while work proceeds."""


@contextmanager
def reporting(quiet: bool = False, clock: Clock | None = None) -> Iterator[Report]:
    """Yield `report(what, done, total)`.

    Args:
        quiet: True to say nothing.
        clock: clock for the time left, the host's by default.
    """
    times = clock if clock is not None else MonotonicClock()
    if quiet:
        yield silent
    elif for_a_program():
        yield _Objects(times)
    elif sys.stderr.isatty():
        with _bars(times) as report:
            yield report
    else:
        yield _Lines(times)


def for_a_program() -> bool:
    """Whether `--progress json` was given."""
    context = click.get_current_context(silent=True)
    return context is not None and context.find_root().params.get("progress") == PROGRESS[1]


def tell(kind: str, data: Mapping[str, Any] | str) -> None:
    """Print one JSON object on stderr, `{kind: data}`."""
    click.echo(json.dumps({kind: data}, allow_nan=False), err=True)


class _Objects:
    """Progress for a program: a JSON object per step of the work, at most five per second."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._paces: dict[str, Pace] = {}
        self._shown_ns: dict[str, int] = {}

    def __call__(self, what: str, done: int, total: int) -> None:
        pace = self._paces.setdefault(what, Pace(self._clock))
        pace.update(done, total)
        now_ns = self._clock.now_ns()
        if 0 < done < total and now_ns < self._shown_ns.get(what, now_ns) + _BETWEEN_NS:
            return
        self._shown_ns[what] = now_ns
        tell("progress", {"what": what, "done": done, "total": total, "left_s": pace.left_s})


class _Lines:
    """Prints a line per tenth of each task, or after half a minute; one line for a task of a single step."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._paces: dict[str, Pace] = {}
        self._tenths: dict[str, int] = {}
        self._shown_ns = 0

    def __call__(self, what: str, done: int, total: int) -> None:
        pace = self._paces.setdefault(what, Pace(self._clock))
        pace.update(done, total)
        if what == WHOLE:
            return
        tenth = 10 * done // max(total, 1)
        now_ns = self._clock.now_ns()
        quiet = now_ns < self._shown_ns + _QUIET_NS
        nothing_new = self._tenths.get(what) == tenth and done != total and quiet
        again = what in self._tenths and (total == 1 or nothing_new)
        self._tenths[what] = tenth
        if again:
            return
        self._shown_ns = now_ns
        words = what if total == 1 else f"{what}: {done}/{total}"
        left = self._left(pace)
        click.echo(f"{words}, {left}" if left else words, err=True)

    def _left(self, pace: Pace) -> str:
        """Time left in words: of the whole work if known, else of this task."""
        whole = self._paces.get(WHOLE)
        if whole is not None and whole.left_s is not None:
            return f"{in_words(whole.left_s)} {WHOLE}"
        return in_words(pace.left_s)


@contextmanager
def _bars(clock: Clock) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Left(ProgressColumn):
        """Time left, counting down between reports."""

        def render(self, task: Task) -> Text:
            pace: Pace = task.fields["pace"]
            return Text("" if task.finished else in_words(pace.left_s), style="progress.remaining")

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Left())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, tuple[TaskID, Pace]] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                pace = Pace(clock)
                tasks[what] = bars.add_task(what, total=total, pace=pace), pace
            task, pace = tasks[what]
            pace.update(done, total)
            bars.update(task, completed=done, total=total, visible=done < total or what == WHOLE)

        yield show
