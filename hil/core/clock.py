"""Clocks for everything that measures, decides or records: integer nanoseconds, monotonic.

`MonotonicClock` is real time. The virtual clock lives in `hil.fakes.world` because sleeping on it
advances the emulated world. Code gets a clock as an argument. Only these read the host's clock directly: the
programs beside the loop (fan daemon, console, viewer, command line), code that waits for them, the watchdog
for calls that do not return, the doctor's check for slow reads, and the date check of a record.
`pyproject.toml` lists these modules; ruff refuses `time` in all others.
"""

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
        offset_ns: offset that turns a time of the clock into ns since the Unix epoch.
        uncertainty_ns: largest error of `offset_ns`, if the host's wall clock is right.
        measured_ns: time of the measurement, on the clock.
    """

    offset_ns: int
    uncertainty_ns: int
    measured_ns: int


Task = Callable[[int], int]
"""Receives the time of the call and returns the time of the next call, ns."""


class Clock(Protocol):
    """Source of time and of waiting; passed as an argument."""

    @abstractmethod
    def now_ns(self) -> int:
        """Time since an arbitrary but fixed start, ns; never decreases."""

    @abstractmethod
    def sleep_until_ns(self, t_ns: int) -> None:
        """Sleep until `t_ns`; return at once if it has passed."""

    @abstractmethod
    def schedule(self, task: Task, due_ns: int) -> Callable[[], None]:
        """Call `task` at `due_ns`, then at each time that it returns, concurrently with the caller.

        In real time it runs in a thread of its own; in virtual time while another call sleeps.

        Returns:
            Function that ends the schedule without waiting for a running call. May be called twice.
        """

    def wall_offset(self) -> WallOffset | None:
        """Offset from this clock to the time of day; None without one (virtual time)."""
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
        """Run `task` in a daemon thread; an exception in `task` ends the thread."""
        ended = threading.Event()

        def work() -> None:
            next_ns = due_ns
            while not ended.wait(max(0, next_ns - time.monotonic_ns()) / NS_PER_S):
                next_ns = task(time.monotonic_ns())

        threading.Thread(target=work, name="scheduled", daemon=True).start()
        return ended.set

    def wall_offset(self) -> WallOffset:
        """Measure the offset: of 25 wall-clock readings, use the one that took least time."""
        looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(_LOOKS)]
        before_ns, wall_ns, after_ns = min(looks, key=lambda look: look[2] - look[0])
        middle_ns, width_ns = (before_ns + after_ns) // 2, after_ns - before_ns
        return WallOffset(wall_ns - middle_ns, width_ns // 2 + 1, middle_ns)


def sleep_punctually(on: bool = True) -> None:
    """Make the kernel end this thread's sleeps on time, not up to 50 us later to save power.

    Linux only (`PR_SET_TIMERSLACK`); no effect elsewhere. Threads and processes started later inherit it.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, int(on), 0, 0, 0)


def local_time() -> str:
    """The host's date, time of day and zone for time stamps of results: ISO 8601, whole seconds."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def seconds(t_ns: int) -> float:
    """Convert nanoseconds to seconds."""
    return t_ns / NS_PER_S


def nanoseconds(t_s: float) -> int:
    """Convert seconds to integer nanoseconds, rounded."""
    return round(t_s * NS_PER_S)
