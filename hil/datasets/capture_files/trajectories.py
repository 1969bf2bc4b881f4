"""Trajectory files of SLAM tools: TUM (`timestamp tx ty tz qx qy qz qw`) and EuRoC (`#timestamp [ns], ...`).

Formats: the TUM RGB-D benchmark's "File Formats", and the EuRoC MAV data set's `state_groundtruth_estimate0`
and `vicon0`, both in the ASL layout. Stamps are of the recorder's clock; z is up.
"""

import numpy as np

from hil.datasets.capture_files.poses import Poses
from hil.datasets.capture_files.tables import number, numbers

UP = "z"
TUM, EUROC = "TUM trajectory", "EuRoC (ASL) trajectory"
_BODY = "the body"


def is_tum(head: str) -> bool:
    """Whether a file that begins like this is a TUM trajectory: rows of eight numbers between spaces."""
    rows = [line.split() for line in head.splitlines()[:-1] if line.strip() and not line.startswith("#")]
    return bool(rows) and all(len(row) == 8 and all(np.isfinite(map_numbers(row))) for row in rows)


def map_numbers(row: list[str]) -> list[float]:
    """Values of the cells of a row."""
    return [number(cell) for cell in row]


def is_euroc(head: str) -> bool:
    """Whether a file that begins like this is a EuRoC trajectory."""
    first = head.partition("\n")[0]
    return first.startswith("#timestamp") and "p_RS_R_x" in first


def read_tum(where: str, text: str) -> dict[str, Poses]:
    """Poses of the body of a TUM trajectory."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    values = numbers(rows, range(8))
    return {_BODY: Poses(values[:, 0], values[:, 1:4], values[:, [7, 4, 5, 6]])}


def read_euroc(where: str, text: str) -> dict[str, Poses]:
    """Poses of the body of a EuRoC trajectory, whose stamps are nanoseconds and quaternions w first."""
    head, *lines = text.splitlines()
    columns = [name.split("[")[0].strip(" #") for name in head.split(",")]
    places = [columns.index(f"p_RS_R_{a}") for a in "xyz"] + [columns.index(f"q_RS_{a}") for a in "wxyz"]
    values = numbers([line.split(",") for line in lines if line.strip()], [0, *places])
    return {_BODY: Poses(1e-9 * values[:, 0], values[:, 1:4], values[:, 4:])}
