"""Worker processes of a procedure: Ctrl-C is left to the one that started them, and they end with it.

A worker takes seconds to start: it imports, and loads machine code. What drives several rounds keeps its
`Workers` for all of them; every job has a bench of its own, so that none knows of the jobs before it.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.pool import Pool
from types import TracebackType
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
    with Workers(min(processes, len(jobs))) as workers:
        yield from workers.at_once(work, jobs)


class Workers:
    """Processes that are started when the first jobs come, and end with the block that they are used in.

    Args:
        processes: how many.
    """

    def __init__(self, processes: int) -> None:
        self.processes = processes
        self._pool: Pool | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.terminate()
            self._pool = None

    def at_once(self, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """Results of jobs in their order, worked on by all processes; arguments as for the function."""
        if not jobs:
            return iter(())
        if self._pool is None:
            self._pool = multiprocessing.get_context("spawn").Pool(self.processes, _ignore_interrupts)
        return self._pool.imap(work, jobs)


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
