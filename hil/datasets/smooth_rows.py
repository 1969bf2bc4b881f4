"""Finds ground truth that was filled in between fewer poses by curves, or smoothed as much.

A capture system's noise differs from row to row. Curves between poses half a second apart have the noise of
these poses and none between them; and they swing before a start and after a stop, while the robot rests.
"""

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate, is_slow
from hil.datasets.truth_at_rest import rests
from hil.datasets.wheel_log import Recording

_GRID_S, _NEAR, _FAR = 0.02, 1, 12
_SHARE, _LEAST_M, _NOTHING_M = 0.04, 1e-6, 1e-9
"""Share of the deviation over 0.24 s that is found over 0.02 s; of measured rows 0.3 and more."""
_SMOOTH = (
    "in rests its ground truth swings by {:.3f} mm over 0.24 s and by {:.0f} times less from row to row, "
    "where measured rows have noise: it was filled in by curves between fewer poses (four in a second, or "
    "less), or smoothed as much; take the poses as measured"
)


def with_smooth_rows(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name rows of ground truth that are smoother than measured ones."""
    out = []
    for one in recordings:
        near_m, far_m = swings_m(one)
        smooth = far_m > _LEAST_M and near_m < _SHARE * far_m
        said = _SMOOTH.format(1e3 * far_m, far_m / max(near_m, _NOTHING_M))
        out.append(one.contradicted(said) if smooth else one)
    return out


def swings_m(one: Recording) -> tuple[float, float]:
    """How far poses at rest are from the middle of those 0.02 s, and 0.24 s, before and after, m; 0 unknown.

    Root mean squares of x, y and the turn at the wheels.
    """
    if not one.has_truth or is_slow(one.truth_t_s):
        return 0.0, 0.0
    lever, near, far = lever_m(one.nominal.geometry), list[Array](), list[Array]()
    for at_s, pose in rests(one):
        grid_s = np.arange(at_s[0], at_s[-1], _GRID_S)
        values = interpolate(grid_s, at_s, pose) * (1.0, 1.0, lever)
        if len(values) > 2 * _FAR:
            near.append(_beside_middle(values, _NEAR))
            far.append(_beside_middle(values, _FAR))
    if not far:
        return 0.0, 0.0
    sizes = [float(np.sqrt(np.mean(np.concatenate(some) ** 2))) for some in (near, far)]
    return sizes[0], sizes[1]


def _beside_middle(values: Array, n: int) -> Array:
    return np.asarray(values[n:-n] - 0.5 * (values[2 * n :] + values[: -2 * n]), dtype=np.float64)
