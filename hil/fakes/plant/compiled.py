"""Which way the physics runs: compiled by numba where that is installed, interpreted otherwise.

Both run the same functions on the same records; interpreted, their arrays are lists meanwhile, which plain
Python indexes three times quicker.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from hil.fakes.plant import kernel
from hil.fakes.plant.records import PATCH, ROBOT
from hil.vocabulary.extras import is_installed
from hil.vocabulary.numpy_records import FLOAT_BYTES, Records, floats

Advance = Callable[[Records, Records, int, float], None]


class ListForm:
    """Records of a kind as objects with the same attributes: numbers, and lists for arrays of one dimension.

    Args:
        dtype: of the records.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._fields: list[tuple[str, ListForm | None, int | slice]] = []
        for name, (kind, at, *_) in (dtype.fields or {}).items():
            first, inner = at // FLOAT_BYTES, ListForm(kind) if kind.fields else None
            many = slice(first, first + kind.itemsize // FLOAT_BYTES)
            self._fields.append((name, inner, many if inner or kind.shape else first))

    def taken(self, block: Records) -> list[Any]:
        """Objects that have the numbers of a block (n,)."""
        return [self._object(row) for row in floats(block).tolist()]

    def put(self, objects: list[Any], block: Records) -> None:
        """Give a block (n,) the numbers of the objects."""
        floats(block)[:] = [self._row(one) for one in objects]

    def _object(self, row: list[float]) -> SimpleNamespace:
        values = {}
        for name, inner, at in self._fields:
            values[name] = row[at] if inner is None else inner._object(row[at])  # type: ignore[arg-type]
        return SimpleNamespace(**values)

    def _row(self, one: Any) -> list[float]:
        row: list[float] = []
        for name, inner, at in self._fields:
            value = getattr(one, name)
            if inner is not None:
                row += inner._row(value)
            elif isinstance(at, slice):
                row += value
            else:
                row.append(value)
        return row


_ROBOT, _PATCH = ListForm(ROBOT), ListForm(PATCH)


@cache
def compiled_advance() -> Advance:
    """The compiled physics; the first call on a machine compiles, later ones load the cache.

    Raises:
        ImportError: numba is not installed.
    """
    from hil.vocabulary.kernels import machine_code

    return machine_code(kernel.advance, np.zeros(1, ROBOT), np.zeros(0, PATCH), 0, 1.0)


def interpreted_advance(robots: Records, patches: Records, n: int, adhesion_factor: float) -> None:
    """The same physics in plain Python; see `kernel.advance`."""
    robot, surface = _ROBOT.taken(robots), _PATCH.taken(patches)
    kernel.advance(robot, surface, n, adhesion_factor)  # type: ignore[arg-type]
    _ROBOT.put(robot, robots)


def choose_advance(compiled: bool | None) -> Advance:
    """Compiled, interpreted, or (None) compiled if it can be."""
    if compiled is None:
        compiled = is_installed("fast")
    return compiled_advance() if compiled else interpreted_advance
