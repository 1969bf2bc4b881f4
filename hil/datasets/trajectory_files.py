"""Writes planar trajectories in the formats of the TUM RGB-D and KITTI benchmarks, as evo reads them.

TUM has a row `timestamp tx ty tz qx qy qz qw` for each pose, KITTI a 3 x 4 matrix by rows, without stamps.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hil.core.geometry import Array
from hil.support.atomic_files import write_text

_OTHERS = re.compile(r"[^\w.-]+")


def write_trajectories(folder: Path, t_s: Array, paths: Mapping[str, Array]) -> list[Path]:
    """Write `NAME.tum` and `NAME.kitti` for each trajectory, all at the same instants.

    Args:
        folder: folder to write to, made if it is not there.
        t_s: (n,) instants, s.
        paths: poses (n, 3) by name; instants at which one is not known are left out of all.

    Raises:
        DataError: a file cannot be written.
    """
    known = np.all([np.isfinite(poses).all(axis=1) for poses in paths.values()], axis=0)
    written = []
    for name, poses in paths.items():
        for suffix, rows in (("tum", _tum(t_s[known], poses[known])), ("kitti", _kitti(poses[known]))):
            text = "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in rows.tolist())
            written.append(write_text(folder / f"{_OTHERS.sub('_', name)}.{suffix}", text))
    return written


def _tum(t_s: Array, poses: Array) -> Array:
    x, y, theta = poses.T
    none = np.zeros_like(x)
    return np.column_stack([t_s, x, y, none, none, none, np.sin(0.5 * theta), np.cos(0.5 * theta)])


def _kitti(poses: Array) -> Array:
    (x, y, theta), none = poses.T, np.zeros(len(poses))
    c, s, one = np.cos(theta), np.sin(theta), none + 1.0
    return np.column_stack([c, -s, none, x, s, c, none, y, none, none, one, none])
