"""Progress on stderr: a rich bar on a terminal, elsewhere a plain line per tenth of the work."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click


@contextmanager
def reporting(quiet: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """Yield `report(what, done, total)`."""
    if quiet:
        yield lambda what, done, total: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, TaskID

        with Progress(console=Console(stderr=True), transient=True) as bars:
            tasks: dict[str, TaskID] = {}

            def show(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bars.add_task(what, total=total)
                bars.update(tasks[what], completed=done, total=total)

            yield show
    else:
        tenths: dict[str, int] = {}

        def say(what: str, done: int, total: int) -> None:
            tenth = 10 * done // max(total, 1)
            if tenths.get(what) != tenth or done == total:
                tenths[what] = tenth
                click.echo(f"{what}: {done}/{total}", err=True)

        yield say
