"""Errors between two planar trajectories: alignments and relative pose errors, as evo defines them.

The definitions are those of evo 1.38 (https://github.com/MichaelGrupp/evo): `align_origin`, `align` (Umeyama,
IEEE PAMI 1991), and `RPE` over consecutive pairs by the path of the reference.
Poses are (x m, y m, theta rad).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array, wrap_array
from hil.core.known_names import ALIGNMENTS


def aligned(estimate: Array, truth: Array, how: str) -> Array:
    """Estimated poses (n, 3), moved as a whole onto the truth (n, 3).

    Args:
        estimate: estimated poses.
        truth: true poses at the same instants.
        how: one of `hil.core.known_names.ALIGNMENTS`.

    Raises:
        UsageError: another alignment.
    """
    if how not in ALIGNMENTS:
        raise UsageError(f"alignment {how!r}", expected=" or ".join(ALIGNMENTS))
    if how == "none" or not len(estimate):
        return estimate
    if how == "origin":
        turn = float(truth[0, 2] - estimate[0, 2])
        return _moved(estimate, turn, estimate[0, :2], truth[0, :2])
    middle, goal = estimate[:, :2].mean(axis=0), truth[:, :2].mean(axis=0)
    a, b = (path[:, :2] - at for path, at in ((estimate, middle), (truth, goal)))
    sine, cosine = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)
    return _moved(estimate, float(np.arctan2(sine, cosine)), middle, goal)


def _moved(poses: Array, turn: float, about: Array, to: Array) -> Array:
    c, s = np.cos(turn), np.sin(turn)
    place = (poses[:, :2] - about) @ np.array([[c, s], [-s, c]]) + to
    return np.column_stack([place, poses[:, 2] + turn])


def pairs_by_path(truth: Array, delta_m: float) -> list[tuple[int, int]]:
    """Consecutive pairs of rows between which the path (n, 3) grows by at least `delta_m`."""
    ids, since = [0], 0.0
    for k, step in enumerate(np.hypot(*np.diff(truth[:, :2], axis=0).T).tolist(), start=1):
        since += step
        if since >= delta_m:
            ids.append(k)
            since = 0.0
    return list(pairwise(ids))


def relative_errors(estimate: Array, truth: Array, pairs: Sequence[tuple[int, int]]) -> tuple[Array, Array]:
    """Relative pose errors (m,) of pairs of rows: length of the translation, m, and angle, rad.

    Args:
        estimate: (n, 3) estimated poses.
        truth: (n, 3) true poses at the same instants.
        pairs: rows of the begin and the end of each pair.
    """
    if not pairs:
        return np.zeros(0), np.zeros(0)
    first, second = np.array(pairs).T
    (x, y, turn), (true_x, true_y, true_turn) = (_steps(path, first, second) for path in (estimate, truth))
    return np.hypot(x - true_x, y - true_y), np.abs(wrap_array(turn - true_turn))


def _steps(path: Array, first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Steps between rows, each in the frame of its begin."""
    (x, y, turn), heading = (path[second] - path[first]).T, path[first, 2]
    c, s = np.cos(heading), np.sin(heading)
    return c * x + s * y, c * y - s * x, turn
