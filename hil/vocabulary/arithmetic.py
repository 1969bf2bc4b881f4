"""Arithmetic on flat vectors: machine code where numba is installed, Python elsewhere.

A function is written once, on indexed numbers. Compiled it runs on arrays; interpreted on lists, which plain
Python indexes three times quicker. Both give the same bits where it keeps to arithmetic, roots, sines and
cosines; `math.hypot` is another one in machine code. Who keeps numbers for such functions alone keeps them in
their form (`vector`, `rows`); who has an array anyhow takes `on_array`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np

from hil.vocabulary.extras import is_installed
from hil.vocabulary.geometry import Array

Vector: TypeAlias = Array | list[float]
Rows: TypeAlias = Array | list[list[Any]]

F = TypeVar("F", bound=Callable[..., Any])

_made: dict[Callable[..., Any], Callable[..., Any]] = {}


def vector(values: Sequence[float] | Array) -> Vector:
    """Numbers (n,) that arithmetic may read and change."""
    numbers = np.array(values, dtype=np.float64)
    return numbers if is_installed("fast") else numbers.tolist()


def rows(block: Array) -> Rows:
    """Numbers (n, m) that arithmetic may read row by row."""
    return block if is_installed("fast") else block.tolist()


def places(block: Rows) -> list[Any]:
    """What takes other numbers for each row, as a whole: `place[:] = numbers`."""
    return [row if isinstance(row, list) else memoryview(row) for row in block]


def listed(block: Rows) -> list[list[Any]]:
    """A block's rows as lists that stay as they are."""
    return block.tolist() if isinstance(block, np.ndarray) else [list(row) for row in block]


def quick(function: F, *arguments: Any) -> F:
    """The function, compiled for arguments of these types if it can be; it must be called with no others.

    The first call on a machine compiles, later ones load the cache.
    """
    if not is_installed("fast"):
        return function
    if function not in _made:
        from hil.vocabulary.kernels import machine_code

        _made[function] = machine_code(function, *arguments)
    return _made[function]  # type: ignore[return-value]


def on_array(function: Callable[..., Any], numbers: Array, *others: Any) -> Callable[..., Any]:
    """As `quick`, for a function that is always given an array.

    Args:
        function: takes a vector, which it may change, and floats or tuples of these.
        numbers: (n,) of the kind that it will be called with: contiguous float64.
        others: of the types that it will be called with; there must be no others.
    """
    if is_installed("fast"):
        return quick(function, numbers, *others)

    def interpreted(numbers: Array, *others: Any) -> Any:
        listed_numbers = numbers.tolist()
        found = function(listed_numbers, *others)
        numbers[:] = listed_numbers
        return found

    return interpreted
