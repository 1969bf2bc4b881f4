"""Which way the physics runs: compiled by numba where that is installed, interpreted otherwise.

Both run the one `kernel.advance`; interpreted, the numbers are unpacked into lists first, which plain
Python indexes three times quicker.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from hil.fakes.plant import kernel
from hil.vocabulary.extras import is_installed
from hil.vocabulary.geometry import Array

Advance = Callable[[int, float, Array], None]


@cache
def compiled_advance() -> Advance:
    """The compiled physics; the first call on a machine compiles, later ones load the cache.

    Raises:
        ImportError: numba is not installed.
    """
    from hil.vocabulary.kernels import machine_code

    return machine_code(kernel.advance_all, 0, 1.0, np.zeros(kernel.CONSTANTS + kernel.PATCHES))


def interpreted_advance(n: int, adhesion_factor: float, numbers: Array) -> None:
    """The same physics in plain Python, on the vector (184 + n,) of `kernel.advance_all`."""
    values = numbers.tolist()
    state, commands = values[: kernel.STATE_SIZE], values[kernel.STATE_SIZE : kernel.CONSTANTS]
    kernel.advance(n, adhesion_factor, values[kernel.CONSTANTS :], state, commands)
    numbers[: kernel.STATE_SIZE] = state


def choose_advance(compiled: bool | None) -> Advance:
    """Compiled, interpreted, or (None) compiled if it can be."""
    if compiled is None:
        compiled = is_installed("fast")
    return compiled_advance() if compiled else interpreted_advance
