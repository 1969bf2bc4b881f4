"""Which way the physics runs: compiled by numba where that is installed, interpreted otherwise.

Both run the one `kernel.advance`; interpreted, the arrays are unpacked into lists first, which plain
Python indexes three times quicker.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from hil.fakes.plant import kernel
from hil.vocabulary.extras import is_installed
from hil.vocabulary.geometry import Array

Advance = Callable[[int, float, Array, Array, Array], None]


@cache
def compiled_advance() -> Advance:
    """The compiled physics; the first call on a machine compiles, later ones load the cache.

    Raises:
        ImportError: numba is not installed.
    """
    from hil.vocabulary.kernels import machine_code

    vectors = (np.zeros(size) for size in (kernel.PATCHES, kernel.STATE_SIZE, kernel.COMMANDS_SIZE))
    return machine_code(kernel.advance, 0, 1.0, *vectors)


def interpreted_advance(n: int, adhesion_factor: float, c: Array, s: Array, q: Array) -> None:
    """The same physics in plain Python, on the vectors `c` (n,), `s` (138,) and `q` (40,) of the kernel."""
    state = s.tolist()
    kernel.advance(n, adhesion_factor, c.tolist(), state, q.tolist())
    s[:] = state


def choose_advance(compiled: bool | None) -> Advance:
    """Compiled, interpreted, or (None) compiled if it can be."""
    if compiled is None:
        compiled = is_installed("fast")
    return compiled_advance() if compiled else interpreted_advance
