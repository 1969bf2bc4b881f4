"""Wheel rows from `sensor_msgs/JointState` messages, each with all joints of the wheels or some of them.

Publishers of ros2_control may send drive and steering apart. A row is then an instant of the first drive
joint. The other joints are interpolated to it between two of their own messages that are at most 0.1 s apart,
and are NaN elsewhere, as they are where a counter wraps between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.core.interpolation import between_samples
from hil.datasets.plain_csv import TRUTH_GAP_S

_DRIVES = 4


class JointRows:
    """What the messages of one topic say of the joints of the wheels.

    Args:
        path: the bag, for messages.
        topic: that they come by.
        names: four drive joints and four steering joints, order FL, BL, BR, FR.
    """

    def __init__(self, path: Path, topic: str, names: Sequence[str]) -> None:
        self._path, self._topic, self._names = path, topic, tuple(names)
        self._rows: list[list[float]] = []
        self._named: list[list[bool]] = []
        self._others: dict[str, None] = {}

    def add(self, message: Any) -> None:
        """Take a message; raises `DataError` where it has fewer positions than joints, and no rates alone."""
        index = {name: i for i, name in enumerate(message.name)}
        named = [name in index for name in self._names]
        self._named.append(named)
        if not all(named):
            self._others.update(dict.fromkeys(index))
        rates_alone = not len(message.position) and len(message.velocity) >= len(index)
        if any(named) and len(message.position) < len(index) and not rates_alone:
            raise DataError(
                str(self._path),
                f"{self._topic} carries {len(message.position)} positions",
                expected="one per joint",
            )
        at = [index.get(name, -1) for name in self._names]
        rates = message.velocity if len(message.velocity) == len(message.name) else ()
        self._rows.append(
            [*(_number(message.position, i) for i in at), *(_number(rates, i) for i in at[:_DRIVES])]
        )

    def rows(self, t_s: Array) -> tuple[Array, Array]:
        """Times (n,) of the rows and (n, 12): angles of drive and steering, rad, and drive rates, rad/s.

        Args:
            t_s: (m,) times of the messages, as they were added; at least one.

        Raises:
            DataError: a joint that no message names.
        """
        named, values = np.array(self._named, dtype=bool), np.array(self._rows, dtype=np.float64)
        missing = [name for k, name in enumerate(self._names) if not named[:, k].any()]
        if missing:
            raise DataError(
                str(self._path),
                f"{self._topic} has no joint {', '.join(missing)}",
                expected=f"some of {', '.join(self._others)}"
                if self._others
                else "messages that name joints",
            )
        first = named[:, 0]
        out = values[first]
        for j in range(len(self._names)):
            if not named[first, j].all():
                own = named[:, j]
                columns = [j, len(self._names) + j] if j < _DRIVES else [j]
                out[:, columns] = _at(t_s[first], t_s[own], values[own][:, columns])
        return t_s[first], out


def _number(values: Any, i: int) -> float:
    return float(values[i]) if 0 <= i < len(values) else np.nan


def _at(at_s: Array, t_s: Array, values: Array) -> Array:
    """Columns of one joint, its angle first, at other instants."""
    t_s, order = np.unique(t_s, return_index=True)
    values = values[order]
    found = between_samples(at_s, t_s, values, longest=TRUTH_GAP_S, before=TRUTH_GAP_S, after=TRUTH_GAP_S)
    if len(t_s) > 1:
        end = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        wraps = np.abs(values[end, 0] - values[end - 1, 0]) > np.pi
        found[wraps & (at_s > t_s[end - 1]) & (at_s < t_s[end])] = np.nan
    return found
