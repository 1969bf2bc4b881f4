"""CSV exports of Vicon Nexus and Tracker: segments or objects as rotation vectors or quaternions, z up.

A section begins with its name and its rate in Hz; below are the names of the segments, the columns, their
units, and the rows up to an empty one. RX, RY, RZ are helical angles: a rotation vector. With RW they are a
quaternion. Times are frame numbers over the rate.
"""

import numpy as np

from hil.core.errors import DataError
from hil.datasets.capture_files.poses import Poses, quat_of_vectors
from hil.datasets.capture_files.tables import number, numbers, scale_of

NAME, UP = "Vicon CSV export", "z"
_WITH_BODIES = ("Segments", "Objects")
_SECTIONS = (*_WITH_BODIES, "Trajectories", "Devices", "Joints", "Model Outputs")
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_RADIANS = {"rad": 1.0, "deg": float(np.pi / 180.0)}


def is_it(head: str) -> bool:
    """Whether a file that begins like this is one."""
    return head.partition("\n")[0].strip("\r ,;\t") in _SECTIONS


def read(where: str, text: str) -> dict[str, Poses]:
    """Poses of each segment or object, by its name; raises `DataError` for what the export lacks."""
    mark = next((m for m in ",;\t" if f"Frame{m}" in text), ",")
    rows = [[cell.strip() for cell in line.split(mark)] for line in text.splitlines()]
    at = next((k for k, row in enumerate(rows) if row[0] in _WITH_BODIES), -1)
    if at < 0 or len(rows) < at + 6:
        raise DataError(
            where,
            f"is a {NAME} without segments or objects, so without headings",
            expected="a section Segments or Objects",
            remedy="let Vicon track an object of three markers or more, and export its global angles",
        )
    rate_hz, names, columns, units = number(rows[at + 1][0]), *rows[at + 2 : at + 5]
    data = []
    for row in rows[at + 5 :]:
        if not row[0]:
            break
        data.append(row)
    t_s = numbers(data, [0])[:, 0] / rate_hz
    out = {}
    for begin in [k for k, name in enumerate(columns) if name == "RX"]:
        width = 4 if columns[begin + 3 : begin + 4] == ["RW"] else 3
        place = begin + width
        if columns[place : place + 3] != ["TX", "TY", "TZ"]:
            continue
        name = next((n for n in reversed(names[: begin + 1]) if n), "").removeprefix("Global Angle ")
        subject, _, segment = name.partition(":")
        name = subject if segment == subject else name
        angles = numbers(data, range(begin, place))
        at_m = numbers(data, range(place, place + 3)) * scale_of(where, units[place], _METRES)
        if width == 3:
            q = quat_of_vectors(angles * scale_of(where, units[begin], _RADIANS))
        else:
            q = angles[:, [3, 0, 1, 2]]
        lost = np.all(np.hstack([angles, at_m]) == 0.0, axis=1)
        out[name] = Poses(t_s, np.where(lost[:, None], np.nan, at_m), q)
    return out
