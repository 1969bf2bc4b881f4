"""Arithmetic on a flat vector: machine code where numba is installed, Python elsewhere.

A function is written once, on indexed numbers. Compiled it runs on the array; interpreted on a list of the
same numbers, which plain Python indexes three times quicker. Both give the same bits where it keeps to
arithmetic, roots, sines and cosines; `math.hypot` is another one in machine code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from hil.vocabulary.extras import is_installed
from hil.vocabulary.geometry import Array

Vector: TypeAlias = Array | list[float]

_made: dict[Callable[..., Any], Callable[..., Any]] = {}


def quick(function: Callable[..., Any], numbers: Array, *others: Any) -> Callable[..., Any]:
    """The function of a flat vector, compiled if it can be; the first call on a machine compiles.

    Args:
        function: takes a vector, which it may change, and floats or tuples of these.
        numbers: (n,) of the kind that it will be called with: contiguous float64.
        others: of the types that it will be called with; there must be no others.
    """
    if not is_installed("fast"):
        return _on_lists(function)
    if function not in _made:
        from hil.vocabulary.kernels import machine_code

        _made[function] = machine_code(function, numbers, *others)
    return _made[function]


def _on_lists(function: Callable[..., Any]) -> Callable[..., Any]:
    def interpreted(numbers: Array, *others: Any) -> Any:
        listed = numbers.tolist()
        found = function(listed, *others)
        numbers[:] = listed
        return found

    return interpreted
