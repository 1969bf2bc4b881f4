"""Waypoints of a CSV file: read, bounded and checked before anything is opened."""

from __future__ import annotations

import csv
import io
from itertools import islice
from pathlib import Path

import numpy as np

from hil.core.errors import DataError, reason_of
from hil.core.geometry import Array
from hil.support.file_reading import read_text

MOST_WAYPOINTS = 10_000
_MOST_BYTES = 16 << 20
_FARTHEST = 1000.0
"""What a coordinate may be, m or rad: further than the longest motion goes."""
_SAME = 1e-6
"""Nobody drives a way of a micrometre, or turns by a microradian."""


def read_waypoints(path: Path) -> list[Array]:
    """Poses, (3,) each, of a CSV file with the header `x,y,theta` (m, m, rad).

    Raises:
        DataError: it cannot be read, is no such list, or holds fewer than two poses or more than 10 000, one
            that is too far away, or the same twice in a row.
    """
    try:
        text = read_text(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None
    try:
        rows = csv.DictReader(io.StringIO(text, newline=""))
        found = [
            (rows.line_num, [float(row[k]) for k in ("x", "y", "theta")])
            for row in islice(rows, MOST_WAYPOINTS + 1)
        ]
    except (KeyError, TypeError, ValueError, csv.Error):
        raise DataError(str(path), "is no waypoint list", expected="header x,y,theta and numbers") from None
    _check(path, found)
    return [np.array(pose) for _, pose in found]


def _check(path: Path, found: list[tuple[int, list[float]]]) -> None:
    """Refuse what cannot be driven through, naming the line of the file."""
    if len(found) > MOST_WAYPOINTS:
        raise DataError(
            str(path),
            f"holds more than {MOST_WAYPOINTS} waypoints",
            expected=f"at most {MOST_WAYPOINTS}",
            remedy="leave out points on straight lines, or divide the motion",
        )
    before: list[float] = []
    for line_number, pose in found:
        if not all(abs(value) <= _FARTHEST for value in pose):
            raise DataError(
                str(path),
                f"line {line_number} holds {', '.join(f'{value:g}' for value in pose)}",
                expected=f"finite numbers from {-_FARTHEST:g} to {_FARTHEST:g}",
            )
        if before and all(abs(a - b) < _SAME for a, b in zip(pose, before, strict=True)):
            raise DataError(
                str(path),
                f"line {line_number} repeats the waypoint before it",
                expected="waypoints that differ",
                remedy="leave it out",
            )
        before = pose
    if len(found) < 2:
        raise DataError(str(path), f"holds {len(found)} waypoint(s)", expected="at least 2")
