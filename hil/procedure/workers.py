"""Worker processes of a procedure: each starts afresh, and Ctrl-C is left to the one that started them."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, TypeVar

from hil.vocabulary.clock import NS_PER_S

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.procedure.bench_source import BenchSource

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


def driven(source: BenchSource, drive: Callable[[Bench], Result]) -> tuple[Result, float]:
    """What driving a bench of its own gives, and how long that took on its clock, s.

    Args:
        source: opened for it, and closed afterwards.
        drive: called with the bench.
    """
    with source.open() as bench:
        begin_ns = bench.clock.now_ns()
        return drive(bench), (bench.clock.now_ns() - begin_ns) / NS_PER_S


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
