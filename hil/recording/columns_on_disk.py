"""Numbers of a long drive: those of older cycles are in a file, and read back by name when asked for."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.geometry import Array


class Stretch(NamedTuple):
    """Columns of successive cycles.

    Attributes:
        cycles: number of cycles.
        values: (cycles, ...) columns by name in memory; empty for a stretch on the disk.
        names: names in the file, whose columns follow each other there.
        shapes: shapes of one row of these columns.
        at: byte of the file at which they begin.
    """

    cycles: int
    values: Mapping[str, Array]
    names: tuple[str, ...] = ()
    shapes: tuple[tuple[int, ...], ...] = ()
    at: int = 0

    @classmethod
    def written(cls, file: Any, values: Mapping[str, Array], cycles: int) -> Stretch:
        """Write columns of floats to the end of a file; raises `OSError`."""
        at = file.seek(0, os.SEEK_END)
        file.write(b"".join(column.tobytes() for column in values.values()))
        file.flush()
        return cls(cycles, {}, tuple(values), tuple(column.shape[1:] for column in values.values()), at)

    def read(self, name: str, file: Any) -> Array:
        """Column of a name; NaN where this stretch has none."""
        if name in self.names:
            number = self.names.index(name)
            sizes = [8 * self.cycles * math.prod(shape) for shape in self.shapes[: number + 1]]
            file.seek(self.at + sum(sizes[:-1]))
            shape = (self.cycles, *self.shapes[number])
            return np.frombuffer(file.read(sizes[-1]), dtype=np.float64).reshape(shape)
        return self.values[name] if name in self.values else np.full(self.cycles, np.nan)


class ColumnsOnDisk(Mapping[str, Array]):
    """Columns of all cycles, (n, ...) by name.

    Args:
        stretches: the parts, in order.
        file: file of those on the disk.
        owner: keeps the file open.
    """

    def __init__(self, stretches: Sequence[Stretch], file: Any, owner: object) -> None:
        self._stretches, self._file, self._owner = tuple(stretches), file, owner
        self._names = dict.fromkeys(name for s in stretches for name in (*s.names, *s.values))

    def __getitem__(self, name: str) -> Array:
        if name not in self._names:
            raise KeyError(name)
        return np.concatenate([stretch.read(name, self._file) for stretch in self._stretches])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)
