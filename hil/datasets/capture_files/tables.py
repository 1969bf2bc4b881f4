"""Cells of a text table as numbers, and the columns of a row of names."""

import math
from collections.abc import Sequence

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array


def number(cell: str) -> float:
    """Value of a cell; NaN for an empty one or text."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def numbers(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> Array:
    """Values (n, k) of some columns; NaN in rows that end before a column."""
    cells = [[number(row[k]) if k < len(row) else math.nan for k in columns] for row in rows]
    return np.array(cells, dtype=np.float64).reshape(-1, len(columns))


def scale_of(where: str, unit: str, known: dict[str, float]) -> float:
    """Factor of a unit to SI; raises `DataError` for one that is not known."""
    if (factor := known.get(unit.strip().lower())) is None:
        raise DataError(where, f"has the unit {unit.strip()!r}", expected="one of " + ", ".join(known))
    return factor
