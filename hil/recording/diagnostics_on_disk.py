"""Diagnostics of a long drive: those of older cycles are in a file, and read back by name when asked for."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.geometry import Array


class Stretch(NamedTuple):
    """Diagnostics of successive cycles.

    Attributes:
        cycles: number of cycles.
        values: (cycles,) values by name in memory; empty for a stretch on the disk.
        names: names in the file, whose values follow each other there.
        at: byte of the file at which they begin.
    """

    cycles: int
    values: Mapping[str, Array]
    names: tuple[str, ...] = ()
    at: int = 0

    @classmethod
    def written(cls, file: Any, values: Mapping[str, Array], cycles: int) -> Stretch:
        """Write values to the end of a file; raises `OSError`."""
        at = file.seek(0, os.SEEK_END)
        file.write(b"".join(column.tobytes() for column in values.values()))
        file.flush()
        return cls(cycles, {}, tuple(values), at)

    def read(self, name: str, file: Any) -> Array:
        """Values of a name; NaN where this stretch has none."""
        if name in self.names:
            size = 8 * self.cycles
            file.seek(self.at + size * self.names.index(name))
            return np.frombuffer(file.read(size), dtype=np.float64)
        return self.values[name] if name in self.values else np.full(self.cycles, np.nan)


class DiagnosticsOnDisk(Mapping[str, Array]):
    """Diagnostics of all cycles, (n,) by name.

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
