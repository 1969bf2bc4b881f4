"""Worker processes of a procedure: each starts afresh, and Ctrl-C is left to the one that started them."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def at_once(
    work: Callable[[Job], Result], jobs: Sequence[Job], processes: int
) -> Generator[Result, None, None]:
    """Results of jobs in their order, so many of which are worked on at a time; closing it ends the workers.

    Args:
        work: a function of a module, to be called in another process.
        jobs: what can be sent there.
        processes: how many at most.
    """
    if jobs:
        context = multiprocessing.get_context("spawn")
        with context.Pool(min(processes, len(jobs)), _ignore_interrupts) as pool:
            yield from pool.imap(work, jobs)


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
