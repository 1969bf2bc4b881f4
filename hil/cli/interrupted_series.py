"""Ctrl-C, SIGTERM and SIGHUP during a series of runs: finished runs are kept and shown."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

import click

from hil.core.errors import Aborted, DataError
from hil.support.interrupt_signals import handled_by


@contextmanager
def shown_when_ended(finished: Callable[[], str], show: Callable[[], str]) -> Iterator[None]:
    """End the block early as `Aborted`, with a page of what is finished.

    Args:
        finished: function to the progress so far, in words, as "3 of 20 runs are finished".
        show: function that writes it; returns the page, or an empty text where nothing is finished.

    Raises:
        Aborted: a signal, or the block itself, ended it.
    """

    def stop(number: int, _frame: FrameType | None) -> None:
        # code that collects errors does not collect a KeyboardInterrupt
        raise KeyboardInterrupt("" if number == signal.SIGINT else signal.Signals(number).name)

    with handled_by(stop):
        try:
            yield
        except (KeyboardInterrupt, Aborted) as ended:
            _show(show, finished())
            if isinstance(ended, Aborted):
                raise
            how = f"ended by {ended}" if str(ended) else "interrupted"
            raise Aborted(
                f"the campaign was {how}; {finished()}", remedy="give the same command with --resume"
            ) from None


def _show(show: Callable[[], str], finished: str) -> None:
    try:
        page = show()
    except DataError as error:
        click.echo(f"no page of what is finished: {error}", err=True)
        return
    if page:
        click.echo(f"page of what is finished ({finished}): {page}", err=True)
