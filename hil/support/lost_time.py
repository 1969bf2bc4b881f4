"""Time that this computer lost: threads were ready to run and had no processor, as Linux counts it.

Where the system does not count it, it is zero. What the host of a virtual machine takes away is not in it.
"""

import os
import threading
from collections.abc import Collection, Mapping

LOOP, EMULATOR = "loop", "emulator"
_NOTHING: Mapping[str, int] = {}
_BYTES, _WAITED = 64, 1


class _Thread:
    """The time for which one thread has waited for a processor.

    Args:
        path: path of the kernel's count.
    """

    def __init__(self, path: str) -> None:
        self._waited_ns = 0
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            self._fd = -1
        self.since_ns()

    def since_ns(self) -> int:
        """Time since the last call; 0 for a thread that has ended."""
        before_ns = self._waited_ns
        if self._fd >= 0:
            try:
                self._waited_ns = int(os.pread(self._fd, _BYTES, 0).split()[_WAITED])
            except (OSError, IndexError, ValueError):
                self.close()
        return self._waited_ns - before_ns

    def close(self) -> None:
        """Stop counting. Idempotent."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


class LostTime:
    """What a control loop lost, and the processes that emulate its devices.

    Args:
        emulators: process ids of emulators, whose main threads serve the devices.
    """

    def __init__(self, emulators: Collection[int] = ()) -> None:
        self._emulators = emulators
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
            self._threads = [(LOOP, _Thread("/proc/thread-self/schedstat"))]
            for pid in self._emulators:
                self._threads.append((EMULATOR, _Thread(f"/proc/{pid}/task/{pid}/schedstat")))
        for name, thread in self._threads:
            if since_ns := thread.since_ns():
                self._taken[name] = self._taken.get(name, 0) + since_ns
