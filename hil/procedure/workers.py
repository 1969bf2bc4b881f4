"""Worker processes of a procedure: each starts afresh, and Ctrl-C is left to the one that started them."""

from __future__ import annotations

import multiprocessing
import signal
from multiprocessing.pool import Pool


def worker_pool(processes: int) -> Pool:
    """A pool of that many; leaving its context ends them."""
    return multiprocessing.get_context("spawn").Pool(processes, _ignore_interrupts)


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
