"""Clocks: the time of everything that measures, decides or records. Integer nanoseconds on a monotonic axis.

`MonotonicClock` is real time. The virtual clock lives in `hil.fakes.world` because sleeping on it
advances the emulated world. Either is handed in. The host's own clock serves the programs beside the loop
(fan daemon, console, viewer, command line), what waits for them, the watch for calls that do not return, the
doctor's look at slow reads, and the day on which a record is still valid. `pyproject.toml` lists these
modules; ruff refuses `time` in all others.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from datetime import datetime
from typing import NamedTuple, Protocol

NS_PER_S = 1_000_000_000
_PR_SET_TIMERSLACK = 29
_LOOKS = 25


class WallOffset(NamedTuple):
    """Wall-clock time at a clock's zero.

    Attributes:
        offset_ns: added to a time of the clock it gives ns since the Unix epoch.
        uncertainty_ns: how far `offset_ns` may be off, as far as the host's wall clock itself is right.
        measured_ns: when that was found out, on the clock.
    """

    offset_ns: int
    uncertainty_ns: int
    measured_ns: int


Task = Callable[[int], int]
"""Takes the time at which it is called, and returns when it wants to be called again, ns."""


class Clock(Protocol):
    """Time and waiting, as an argument."""

    @abstractmethod
    def now_ns(self) -> int:
        """Time since an arbitrary but fixed start, ns; never decreases."""

    @abstractmethod
    def sleep_until_ns(self, t_ns: int) -> None:
        """Return at `t_ns` or at once if that has passed."""

    @abstractmethod
    def schedule(self, task: Task, due_ns: int) -> Callable[[], None]:
        """Have something done beside the caller's work, at `due_ns` and whenever it says from then on.

        In real time it runs in a thread of its own; in virtual time while another call sleeps.

        Returns:
            Ends it; a call that is under way is not waited for. May be called twice.
        """

    def wall_offset(self) -> WallOffset | None:
        """What leads from this clock to the time of day; None where nothing does (virtual time)."""
        return None


class MonotonicClock(Clock):
    """The host's monotonic clock."""

    def now_ns(self) -> int:
        """Host monotonic time, ns."""
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        """Sleep to an absolute deadline."""
        while (left_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / NS_PER_S)

    def schedule(self, task: Task, due_ns: int) -> Callable[[], None]:
        """Run `task` in a daemon thread; what it raises ends the thread, so it should not."""
        ended = threading.Event()

        def work() -> None:
            next_ns = due_ns
            while not ended.wait(max(0, next_ns - time.monotonic_ns()) / NS_PER_S):
                next_ns = task(time.monotonic_ns())

        threading.Thread(target=work, name="scheduled", daemon=True).start()
        return ended.set

    def wall_offset(self) -> WallOffset:
        """The offset by the reading of the wall clock that took least between two readings of this one."""
        looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(_LOOKS)]
        before_ns, wall_ns, after_ns = min(looks, key=lambda look: look[2] - look[0])
        middle_ns, width_ns = (before_ns + after_ns) // 2, after_ns - before_ns
        return WallOffset(wall_ns - middle_ns, width_ns // 2 + 1, middle_ns)


def sleep_punctually(on: bool = True) -> None:
    """Have the kernel end this thread's sleeps when they are due, not up to 50 us later to save power.

    Linux, `PR_SET_TIMERSLACK`; nothing elsewhere. Threads and processes started later inherit it.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, int(on), 0, 0, 0)


def local_time() -> str:
    """The host's date, time of day and zone, as results say when they were made: ISO 8601, whole seconds."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def seconds(t_ns: int) -> float:
    """Nanoseconds as seconds."""
    return t_ns / NS_PER_S


def nanoseconds(t_s: float) -> int:
    """Seconds as rounded integer nanoseconds."""
    return round(t_s * NS_PER_S)
