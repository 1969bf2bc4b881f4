"""CSV exports of OptiTrack Motive 2 and 3: rigid bodies as quaternions, y up unless exported otherwise.

Format: docs.optitrack.com, "Data Export: CSV". The first line holds pairs of names and values, the rows above
`Frame,Time (Seconds),...` type, name and component of each column. Times count from the start of the capture.
"""

import csv
import io

import numpy as np

from hil.core.errors import DataError
from hil.datasets.capture_files.poses import Poses
from hil.datasets.capture_files.tables import numbers, scale_of

NAME, UP = "Motive CSV export (OptiTrack)", "y"
_METRES = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254, "feet": 0.3048}
_BODY = "Rigid Body"


def is_it(head: str) -> bool:
    """Whether a file that begins like this is one."""
    return head.startswith("Format Version,")


def read(where: str, text: str) -> dict[str, Poses]:
    """Poses of each rigid body, by its name; raises `DataError` for what the export lacks."""
    rows = list(csv.reader(io.StringIO(text)))
    about = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    at = next((k for k, row in enumerate(rows) if row[:1] == ["Frame"]), 0)
    types = next((k for k, row in enumerate(rows[1:at], 1) if _BODY in row), 0)
    if not at or not types:
        raise DataError(
            where,
            f"is a {NAME} without rigid bodies, so without headings",
            expected="columns of type Rigid Body",
            remedy="let Motive track a rigid body of three markers or more, and export with Rigid Bodies",
        )
    for key, wanted in (("Rotation Type", "Quaternion"), ("Coordinate Space", "Global")):
        if about.get(key, wanted) != wanted:
            raise DataError(
                where, f"is a {NAME} with {key} {about[key]}", expected=wanted, remedy="export it so"
            )
    metres = scale_of(where, about.get("Length Units", "Meters"), _METRES)
    names, parts, axes = rows[types + 1], rows[at - 1], rows[at]
    time = next(k for k, name in enumerate(axes) if name.startswith("Time"))
    data = [row for row in rows[at + 1 :] if row]
    t_s = numbers(data, [time])[:, 0]
    columns: dict[str, dict[str, int]] = {}
    for k, kind in enumerate(rows[types]):
        if kind == _BODY and max(k, 1) < min(len(names), len(parts), len(axes)):
            columns.setdefault(names[k], {}).setdefault(f"{parts[k]} {axes[k]}", k)
    out = {}
    for name, own in columns.items():
        needed = [*(f"Position {a}" for a in "XYZ"), *(f"Rotation {a}" for a in "WXYZ")]
        if all(one in own for one in needed):
            values = numbers(data, [own[one] for one in needed])
            out[name] = Poses(t_s, metres * values[:, :3], np.array(values[:, 3:]))
    return out
