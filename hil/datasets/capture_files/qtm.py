"""TSV exports of Qualisys Track Manager with 6DOF bodies: mm and rotation matrices, z up.

Format: docs.qualisys.com, "6DOF data (.tsv)". Lines of a name and its value, then a line of column names, and
for each body X, Y, Z, roll, pitch, yaw, residual and the matrix, column by column (Rot[0] to Rot[8]). The
matrix is used, since the definition of the angles is a setting.
"""

import numpy as np

from hil.core.errors import DataError
from hil.datasets.capture_files.poses import Poses, quat_of_matrices
from hil.datasets.capture_files.tables import number, numbers

NAME, UP = "QTM TSV export (Qualisys)", "z"
_FIRST = ("FILE_VERSION\t", "NO_OF_FRAMES\t")


def is_it(head: str) -> bool:
    """Whether a file that begins like this is one."""
    return head.startswith(_FIRST)


def read(where: str, text: str) -> dict[str, Poses]:
    """Poses of each 6DOF body, by its name; raises `DataError` for what the export lacks."""
    rows = [line.split("\t") for line in text.splitlines()]
    at = next((k for k, row in enumerate(rows) if any("Rot[0]" in name for name in row)), 0)
    if not at:
        raise DataError(
            where,
            f"is a {NAME} without rotation matrices of bodies, so without headings",
            expected="6DOF data with Rot[0] to Rot[8]",
            remedy="define a 6DOF body, and export 6D data with the header",
        )
    about = {row[0]: row[1:] for row in rows[:at]}
    columns = [name.strip() for name in rows[at]]
    begins = [k for k, name in enumerate(columns) if name.split(" ")[-1] == "X"]
    matrices = [k for k, name in enumerate(columns) if name.endswith("Rot[0]")]
    names = [name for name in about.get("BODY_NAMES", []) if name]
    names = names if len(names) == len(begins) else [f"body {k + 1}" for k in range(len(begins))]
    data = [row for row in rows[at + 1 :] if number(row[-1] or "0") == number(row[-1] or "0")]
    if "Time" in columns:
        t_s = numbers(data, [columns.index("Time")])[:, 0]
    else:
        t_s = np.arange(len(data)) / number(about.get("FREQUENCY", [""])[0])
    out = {}
    for name, begin, matrix in zip(names, begins, matrices, strict=True):
        values = numbers(data, [*range(begin, begin + 3), *range(matrix, matrix + 9)])
        turned = values[:, 3:].reshape(-1, 3, 3).transpose(0, 2, 1)
        out[name] = Poses(t_s, 1e-3 * values[:, :3], quat_of_matrices(np.nan_to_num(turned)))
    return out
