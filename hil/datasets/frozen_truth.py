"""Ground truth that stands still while the wheels roll: a driver that repeats the last pose it had."""

from __future__ import annotations

import numpy as np

from hil.core.geometry import Array
from hil.datasets.truth_jumps import Bools

FROZEN = "ground-truth rows that repeat an earlier pose while the wheels roll (a frozen source) left out"
_ROLLED_RAD, _LITTLE_RAD = 0.08, 0.02


def fresh_rows(truth_t_s: Array, pose: Array, t_s: Array, angle: Array) -> Bools:
    """Which rows (m,) of a ground truth say something: those that do not repeat the pose before them.

    Poses that are equal to the last bit count as repeated where a wheel turns by 0.08 rad (2 mm) meanwhile,
    from the row on at which it has turned by a quarter of that. A robot at rest may be seen without noise.

    Args:
        truth_t_s: (m,) times of the ground truth, s, increasing.
        pose: (m, 3).
        t_s: (n,) times of the wheel rows, s.
        angle: (n, 4) cumulative wheel angles, rad.
    """
    changed = np.concatenate([[True], np.any(np.diff(pose, axis=0) != 0.0, axis=1)])
    first = np.maximum.accumulate(np.where(changed, np.arange(len(pose)), 0))
    wheels = np.column_stack([np.interp(truth_t_s, t_s, column) for column in angle.T])
    rolled = np.max(np.abs(wheels - wheels[first]), axis=1)
    most = np.zeros(len(pose))
    np.maximum.at(most, first, rolled)
    return np.asarray((most[first] < _ROLLED_RAD) | (rolled < _LITTLE_RAD), dtype=np.bool_)
