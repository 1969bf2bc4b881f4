"""While numba compiles: how much LLVM optimises, that Ctrl-C is heeded, and who is told when it begins.

`numba` is None where it is not installed.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np

from hil.vocabulary.when_asked import import_when_asked

# numba loads scipy, which asks numpy for all of its names: half of that time was for Fortran's wrappers
import_when_asked(np, "f2py")

try:
    import numba
except ImportError:
    numba = None

__all__ = ["interrupts_heeded", "little_effort", "numba", "on_compiling"]

_LLVM_EFFORT = 1
"""Of 3: kernels are compiled in three quarters of the time, and are a tenth slower at the most."""


class _LittleEffort:
    """Within, by however many threads, LLVM optimises less; what others compile is left alone."""

    def __init__(self) -> None:
        self._lock, self._within = threading.Lock(), 0
        self._before: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._within:
                self._before = numba.config.OPT
                if "NUMBA_OPT" not in os.environ:
                    numba.config.OPT = type(self._before)(_LLVM_EFFORT)
            self._within += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                numba.config.OPT = self._before


little_effort = _LittleEffort()


@contextmanager
def interrupts_heeded() -> Iterator[None]:
    """Within, Ctrl-C ends a compilation wherever it strikes: LLVM calls Python, and loses what is raised.

    What was lost is raised when numba begins its next step, at the end of the block at the latest.
    """
    handler, shown = signal.getsignal(signal.SIGINT), sys.unraisablehook
    if not _in_main_thread() or not callable(handler):
        yield
        return
    struck = False

    def strike(number: int, frame: FrameType | None) -> None:
        nonlocal struck
        struck = True
        handler(number, frame)

    def show(lost: sys.UnraisableHookArgs) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            shown(lost)

    def heed() -> None:
        if struck and handler is signal.default_int_handler and _in_main_thread():
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, strike)
    sys.unraisablehook = show
    try:
        with _told_of("run_pass", heed):
            yield
    except Exception:
        if struck:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, handler)
        sys.unraisablehook = shown
    heed()


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def on_compiling(call: Callable[[], None]) -> Iterator[None]:
    """Within, a function is called whenever numba begins to compile something that it has not kept."""
    with _told_of("compile", call):
        yield


@contextmanager
def _told_of(step: str, call: Callable[[], None]) -> Iterator[None]:
    """Within, a function is called whenever numba begins such a step: see `numba.core.event`."""
    if numba is None:
        yield
        return
    from numba.core import event

    class Told(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            call()

        def on_end(self, _: Any) -> None:
            return None

    with event.install_listener(f"numba:{step}", Told()):
        yield
