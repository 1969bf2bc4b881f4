"""Clocks: the only source of time. Integer nanoseconds on a monotonic axis.

`MonotonicClock` is real time. The virtual clock lives in `hil.fakes.world` because sleeping on it
advances the emulated world. Nothing else in the project reads the time or sleeps.
"""

from __future__ import annotations

import contextlib
import ctypes
import time
from abc import abstractmethod
from typing import Protocol

NS_PER_S = 1_000_000_000
_PR_SET_TIMERSLACK = 29


class Clock(Protocol):
    """Time and waiting, as an argument."""

    @abstractmethod
    def now_ns(self) -> int:
        """Time since an arbitrary but fixed start, ns; never decreases."""

    @abstractmethod
    def sleep_until_ns(self, t_ns: int) -> None:
        """Return at `t_ns` or at once if that has passed."""


class MonotonicClock(Clock):
    """The host's monotonic clock."""

    def now_ns(self) -> int:
        """Host monotonic time, ns."""
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        """Sleep to an absolute deadline."""
        while (left_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / NS_PER_S)


def sleep_punctually(on: bool = True) -> None:
    """Have the kernel end this thread's sleeps when they are due, not up to 50 us later to save power.

    Linux, `PR_SET_TIMERSLACK`; nothing elsewhere. Threads and processes started later inherit it.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, int(on), 0, 0, 0)


def seconds(t_ns: int) -> float:
    """Nanoseconds as seconds."""
    return t_ns / NS_PER_S


def nanoseconds(t_s: float) -> int:
    """Seconds as rounded integer nanoseconds."""
    return round(t_s * NS_PER_S)
