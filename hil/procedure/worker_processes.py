"""Worker processes of a procedure: they ignore Ctrl-C, and end with the process that started them.

A worker takes seconds to start, because it imports modules and loads machine code. A procedure with several
rounds reuses its `Workers`; every job has its own bench, so that jobs are independent.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.pool import Pool
from types import TracebackType
from typing import TypeVar

from hil.support.interrupt_signals import StopRequest

Job = TypeVar("Job")
Result = TypeVar("Result")


class Workers:
    """Processes that start with the first jobs, and end with the `with` block.

    Args:
        processes: number of processes.
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
        """Yield the results of jobs in order, computed by all processes.

        Args:
            work: a module-level function, called in another process.
            jobs: its arguments; must be picklable.
        """
        if not jobs:
            return iter(())
        if self._pool is None:
            stop = StopRequest()
            with stop.noted():  # a process that is half started would print a traceback
                self._pool = multiprocessing.get_context("spawn").Pool(self.processes, _begin)
            if stop.name:
                signal.raise_signal(signal.Signals[stop.name])
        return self._pool.imap(work, jobs)


def _begin() -> None:
    """Initialise a worker: ignore SIGINT before any import."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
