"""`compiled`: numba's compiler where it is installed, the plain function where it is not.

The kernels are numpy code that runs either way with the same results (tests compare both). Nothing is
compiled until the first call; the machine code is cached beside the sources or in the user's cache.
numba keeps a function's code until that function's own file changes, although the code of every kernel
it calls is inside: here all kernels share one fingerprint, so that none runs with an old version of another.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

try:
    import numba
except ImportError:
    numba = None

AVAILABLE = numba is not None
_IMPORT = re.compile(r"^from hil\.estimator\.compiled import .*\bcompiled$", re.MULTILINE)


def fingerprint(folder: Path) -> str:
    """Short hash of the sources that kernels are made of: their files and where their constants stand."""
    digest = hashlib.sha256()
    constants = (folder / "layout.py", folder.parent / "contact_laws.py")
    kernels = [path for path in sorted(folder.glob("*.py")) if _IMPORT.search(path.read_text("utf-8"))]
    for path in (*constants, *kernels):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


_VERSION = fingerprint(Path(__file__).parent) if AVAILABLE else ""


def compiled(function: F) -> F:
    """Compile a kernel for its first argument types, with a cache where one can be written.

    The cache is named after the function's qualified name, which carries the fingerprint meanwhile.
    """
    if numba is None:
        return function
    name = function.__qualname__
    function.__qualname__ = f"{name}_{_VERSION}"
    try:
        return cast(F, numba.njit(cache=True)(function))
    except RuntimeError:
        return cast(F, numba.njit(function))
    finally:
        function.__qualname__ = name


def plain(function: F) -> F:
    """The uncompiled form of a kernel, for comparing both."""
    return cast(F, getattr(function, "py_func", function))
