"""Hands SIGINT, SIGTERM and SIGHUP (a closed terminal) to one function for the duration of a block.

A robot on a wall is held by the program that commands it: a signal may request the end of that program, but
must not interrupt it, neither the first signal nor a second one.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Install a handler and put the former ones back; only the main thread can, elsewhere nothing happens.

    A signal that is ignored stays ignored: under `nohup` a closed terminal ends nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [n for n in STOPS if signal.getsignal(n) is not signal.SIG_IGN]
    before = {n: signal.signal(n, handler) for n in heard}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


class StopRequest:
    """Records signals and does nothing else; the work in progress reacts at a suitable point.

    Attributes:
        name: name of the first signal; empty before.
    """

    def __init__(self) -> None:
        self.name = ""

    def take(self, number: int, _frame: FrameType | None = None) -> None:
        """Note a signal."""
        self.name = self.name or signal.Signals(number).name

    def noted(self) -> AbstractContextManager[None]:
        """Note the signals of this process for as long as the block lasts."""
        return handled_by(self.take)


def ignore_stop_signals() -> None:
    """Ignore these signals: the work is done and reported, and only the interpreter still has to end."""
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            signal.signal(number, signal.SIG_IGN)
