"""The filter's machine code from nothing, by two processes: each compiles half of what the event loop calls.

numba compiles one function after the other. Both processes keep what they make in numba's cache, so that each
finds there what the other has made; a function that both have come to is made twice, and does no harm.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import numpy as np

from hil.estimator.events import advance, moments
from hil.estimator.history import enter
from hil.estimator.layout import MEMORY, PARAMETERS, ROW, ROW_FLOATS
from hil.estimator.retraction import settle
from hil.estimator.sensors import MARK, account, admit, let_in, new_frame, observe, remember
from hil.estimator.state import AUX, ROWS, STATES
from hil.vocabulary.kernels import compile_for, on_compiling

Call = tuple[Callable[..., Any], tuple[Any, ...]]
"""A kernel, and arguments of the types that it is called with."""

_PAR, _MEMORY, _ROW = (np.zeros(1, kind)[0] for kind in (PARAMETERS, MEMORY, ROW))
_X, _P, _TWO = np.zeros(STATES), np.zeros((STATES, STATES)), np.zeros(2)
_ROWS, _AUX, _CROSS, _OWN = np.zeros(ROWS), np.zeros(AUX), np.zeros((ROWS, STATES)), np.zeros((ROWS, ROWS))
_INTS, _DATA = np.zeros(1, np.int64), np.zeros((1, ROW_FLOATS))
_LATE: tuple[Call, ...] = (
    (settle, (MARK, _X, _P, _ROWS, _ROWS, _AUX, 0, _PAR, _X, _P, _ROWS, _CROSS, _OWN, _CROSS)),
    (observe, (MARK, 0.0, _MEMORY, _ROW, _PAR, _ROWS, _ROWS, _AUX)),
    (enter, (_INTS, _INTS, _INTS, _INTS, _DATA, 0, 0, 0, _INTS, _INTS, _INTS, _DATA)),
)
_EARLY: tuple[Call, ...] = (
    (advance, (_X, _P, 0.0, _PAR, _TWO)),
    (moments, (MARK, _X, _P, _AUX, _PAR, 0, _ROWS, _CROSS, _OWN)),
    (account, (MARK, _MEMORY, _ROWS, _ROWS, _ROWS, 0, 0.0, 0.0)),
    (admit, (MARK, 0.0, _MEMORY, _ROW, _PAR)),
    (let_in, (MARK, 0.0, 0.0, _P, _MEMORY, _PAR)),
    (new_frame, (MARK, 0.0, _X, _P, _MEMORY, _ROW, _PAR)),
    (remember, (MARK, 0.0, _X, _P, _MEMORY, _ROW, _PAR)),
)


def compile_late() -> None:
    """What a process beside compiles."""
    for kernel, arguments in _LATE:
        compile_for(kernel, *arguments)


@contextlib.contextmanager
def by_halves(*, alone: bool = False) -> Iterator[None]:
    """Within, `hil.estimator.events.run` is loaded, or else compiled by this process and one beside it.

    Args:
        alone: the other half is seen to elsewhere.
    """
    beside: list[subprocess.Popen[bytes]] = []
    begun = False

    def begin() -> None:
        nonlocal begun
        if begun:
            return
        begun = True
        if not alone and _cores() > 1:
            quiet = subprocess.DEVNULL
            beside.append(subprocess.Popen([sys.executable, "-m", __name__], stdout=quiet, stderr=quiet))
        for kernel, arguments in _EARLY:
            compile_for(kernel, *arguments)

    try:
        with interrupts_heeded(), on_compiling(begin):
            yield
    except BaseException:
        for process in beside:
            process.terminate()
        raise
    finally:
        for process in beside:
            process.wait()


@contextlib.contextmanager
def interrupts_heeded() -> Iterator[None]:
    """Within, Ctrl-C ends a compilation wherever it strikes: LLVM calls Python, and loses what is raised."""
    handler, shown = signal.getsignal(signal.SIGINT), sys.unraisablehook
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
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

    signal.signal(signal.SIGINT, strike)
    sys.unraisablehook = show
    try:
        yield
    except Exception:
        if struck:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, handler)
        sys.unraisablehook = shown
    if struck and handler is signal.default_int_handler:
        raise KeyboardInterrupt


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


if __name__ == "__main__":
    compile_late()
