"""Worker processes of a procedure: Ctrl-C is left to the one that started them, and they end with it.

A worker takes seconds to start: it imports, and loads machine code. What drives several rounds keeps its
`Workers` for all of them; every job has a bench of its own, so that none knows of the jobs before it.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.pool import Pool
from types import TracebackType
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


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
        """Results of jobs in their order, worked on by all processes.

        Args:
            work: a function of a module, to be called in another process.
            jobs: what can be sent there.
        """
        if not jobs:
            return iter(())
        if self._pool is None:
            self._pool = multiprocessing.get_context("spawn").Pool(self.processes, _begin)
        return self._pool.imap(work, jobs)


def _begin() -> None:
    """The first that a worker does: what its jobs need is imported afterwards."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
