"""Time that this computer lost: threads were ready to run and had no processor, as Linux counts it.

Where the system does not count it, it is zero. What the host of a virtual machine takes away is not in it.
"""

import os
import threading
from collections.abc import Collection, Mapping

from hil.core.clock import NS_PER_S, Clock

LOOP, EMULATOR = "loop", "emulator"
LATE_NS = 100_000_000
"""Lost time from which on a silence of served devices is this computer's."""
_NOTHING: Mapping[str, int] = {}
_BYTES, _WAITED = 128, 1
_READY = b"R"
_LASTS_NS = 2_000_000
"""Time without a change of the counts from which on a thread that is ready waits."""


def late_in_words(lost_ns: int, of_whom: str, meanwhile: str = "") -> str:
    """Text on time that other programs took from somebody; empty below `LATE_NS`."""
    if lost_ns <= LATE_NS:
        return ""
    return (
        f"this computer was late by {lost_ns / NS_PER_S:.2f} s{meanwhile}: other programs took the "
        f"processor from {of_whom}"
    )


class _Thread:
    """The time for which one thread has waited for a processor.

    The kernel adds a wait to its count when the wait ends. A wait that lasts is seen, too: the thread is
    ready to run, and none of its counts has changed since the last look.

    Args:
        folder: folder of the thread in `/proc`.
        clock: clock of the looks.
        own: True for the calling thread, which runs whenever it looks.
    """

    def __init__(self, folder: str, clock: Clock, *, own: bool = False) -> None:
        self._clock, self._own, self._counts = clock, own, b""
        self._waited_ns = self._ahead_ns = self._looked_ns = 0
        self._fds: list[int] = []
        try:
            for name in ("schedstat", "stat"):
                self._fds.append(os.open(f"{folder}/{name}", os.O_RDONLY | os.O_CLOEXEC))
        except OSError:
            self.close()
        self.since_ns()

    def since_ns(self) -> int:
        """Time since the last call; 0 for a thread that has ended."""
        now_ns = self._clock.now_ns()
        since_look_ns = now_ns - self._looked_ns
        try:
            counts = os.pread(self._fds[0], _BYTES, 0)
            if counts == self._counts and (since_look_ns < _LASTS_NS or self._own):
                return 0
            self._looked_ns = now_ns
            if counts == self._counts and self._is_ready():
                self._ahead_ns += since_look_ns
                return since_look_ns
            waited_ns = int(counts.split()[_WAITED])
        except (OSError, IndexError, ValueError):
            self.close()
            return 0
        since_ns = waited_ns - self._waited_ns - self._ahead_ns
        self._counts, self._waited_ns, self._ahead_ns = counts, waited_ns, max(0, -since_ns)
        return max(0, since_ns)

    def _is_ready(self) -> bool:
        """Whether the thread is ready to run; its state follows its name in brackets."""
        return os.pread(self._fds[1], _BYTES, 0).rpartition(b")")[2].split()[0] == _READY

    def close(self) -> None:
        """Stop counting. Idempotent."""
        fds, self._fds = self._fds, []
        for fd in fds:
            os.close(fd)


class LostTime:
    """What a control loop lost, and the processes that emulate its devices.

    Args:
        clock: clock of the loop, in real time.
        emulators: process ids of emulators, whose main threads serve the devices.
    """

    def __init__(self, clock: Clock, emulators: Collection[int] = ()) -> None:
        self._clock, self._emulators = clock, emulators
        self._threads: list[tuple[str, _Thread]] = []
        self._reader = -1
        self._taken: dict[str, int] = {}

    def take(self) -> Mapping[str, int]:
        """Time lost since the last call (ns) by `LOOP`, the calling thread, and `EMULATOR`; without zeros.

        The first call of a thread gives nothing.
        """
        self._count()
        found, self._taken = self._taken, {}
        return found or _NOTHING

    def so_far_ns(self) -> int:
        """Sum of what the next call of `take` would give."""
        self._count()
        return sum(self._taken.values())

    def close(self) -> None:
        """Stop counting; the next call of `take` begins anew. Idempotent."""
        for _, thread in self._threads:
            thread.close()
        self._threads, self._reader, self._taken = [], -1, {}

    def _count(self) -> None:
        if self._reader != (own := threading.get_ident()):
            self.close()
            self._reader = own
            self._threads = [(LOOP, _Thread("/proc/thread-self", self._clock, own=True))]
            for pid in self._emulators:
                self._threads.append((EMULATOR, _Thread(f"/proc/{pid}/task/{pid}", self._clock)))
        for name, thread in self._threads:
            if since_ns := thread.since_ns():
                self._taken[name] = self._taken.get(name, 0) + since_ns
