"""The filter's machine code from nothing, by two processes: each compiles half of what the event loop calls.

numba compiles one function after the other. Both processes keep what they make in numba's cache, so that each
finds there what the other has made; a function that both have come to is made twice, and does no harm.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator.events import advance, compare, moments
from hil.estimator.history import enter
from hil.estimator.layout import MEMORY, PARAMETERS, ROW, ROW_FLOATS
from hil.estimator.retraction import settle
from hil.estimator.sensors import MARK, account, admit, let_in, new_frame, observe, remember
from hil.estimator.state import AUX, ROWS, STATES
from hil.estimator.unscented import Points, points_of
from hil.vocabulary.beside import beside as run_beside
from hil.vocabulary.beside import end_with_parent
from hil.vocabulary.collector import seldom
from hil.vocabulary.compiling import on_compiling
from hil.vocabulary.kernels import compile_for

Call = tuple[Callable[..., Any], tuple[Any, ...]]
"""A kernel, and arguments of the types that it is called with."""

_PAR, _MEMORY, _ROW = (np.zeros(1, kind)[0] for kind in (PARAMETERS, MEMORY, ROW))
_X, _P, _TWO = np.zeros(STATES), np.zeros((STATES, STATES)), np.zeros(2)
_ROWS, _AUX, _CROSS, _OWN = np.zeros(ROWS), np.zeros(AUX), np.zeros((ROWS, STATES)), np.zeros((ROWS, ROWS))
_INTS, _DATA = np.zeros(1, np.int64), np.zeros((1, ROW_FLOATS))


def here(points: Points) -> tuple[Call, ...]:
    """What the process that needs the filter compiles before the event loop itself."""
    return (
        (observe, (MARK, 0.0, _MEMORY, _ROW, _PAR, _ROWS, _ROWS, _AUX)),
        (advance, (_X, _P, 0.0, _PAR, points, _TWO)),
        (account, (MARK, _MEMORY, _ROWS, _ROWS, _ROWS, 0, 0.0, 0.0)),
        (admit, (MARK, 0.0, _MEMORY, _ROW, _PAR)),
        (let_in, (MARK, 0.0, 0.0, _P, _MEMORY, _PAR)),
        (new_frame, (MARK, 0.0, _X, _P, _MEMORY, _ROW, _PAR)),
        (remember, (MARK, 0.0, _X, _P, _MEMORY, _ROW, _PAR)),
    )


def beside(points: Points) -> tuple[Call, ...]:
    """What the other one compiles meanwhile."""
    return (
        (moments, (MARK, _X, _P, _AUX, _PAR, points, 0, _ROWS, _CROSS, _OWN)),
        (settle, (MARK, _X, _P, _ROWS, _ROWS, _AUX, 0, _PAR, _X, _P, _ROWS, _CROSS, _OWN, _CROSS)),
        (compare, (MARK, 0.0, _X, _P, _MEMORY, _ROW, _PAR, points)),
        (enter, (_INTS, _INTS, _INTS, _INTS, _DATA, 0, 0, 0, _INTS, _INTS, _INTS, _DATA)),
    )


def compile_beside(kind: str = "ekf") -> None:
    """Compile that half, for `ekf` or `ukf`."""
    for kernel, arguments in beside(points_of(EstimatorConfig.model_validate({"kind": kind}))):
        compile_for(kernel, *arguments)


@contextlib.contextmanager
def by_halves(points: Points, *, alone: bool = False) -> Iterator[None]:
    """Within, `hil.estimator.events.run` is loaded, or else compiled by this process and one beside it.

    Args:
        points: of the UKF; None for the EKF.
        alone: the other half is seen to elsewhere.
    """
    begun = False

    def begin() -> None:
        nonlocal begun
        if begun:
            return
        begun = True
        if not alone and _cores() > 1:
            helpers.enter_context(run_beside(__name__, "ekf" if points is None else "ukf"))
        for kernel, arguments in here(points):
            compile_for(kernel, *arguments)

    with contextlib.ExitStack() as helpers, on_compiling(begin):
        yield


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


if __name__ == "__main__":
    end_with_parent()
    seldom()
    compile_beside(*sys.argv[1:])
