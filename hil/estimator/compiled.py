"""`compiled`: numba's compiler where it is installed, the plain function where it is not.

The kernels are numpy code that runs either way with the same results (tests compare both). Nothing is
compiled until the first call; the machine code is cached beside the sources or in the user's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

try:
    import numba
except ImportError:
    numba = None

AVAILABLE = numba is not None


def compiled(function: F) -> F:
    """Compile a kernel for its first argument types, with a cache where one can be written."""
    if numba is None:
        return function
    try:
        return cast(F, numba.njit(cache=True)(function))
    except RuntimeError:
        return cast(F, numba.njit(function))


def plain(function: F) -> F:
    """The uncompiled form of a kernel, for comparing both."""
    return cast(F, getattr(function, "py_func", function))
