"""Moves of recordings in strides of one second: by the wheels, and by ground truth.

In the robot's own frame, from second to second, neither drift nor a jump decides.
"""

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.fit_blocks import Blocks
from hil.datasets.nominal_robot import lever_m
from hil.datasets.truth_jumps import Rows
from hil.robot.kinematics import WheelGeometry, twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

BLOCK_S = 0.1
_STRIDE, _LONGEST = 10, 20
_ROLLING, LEAST_ROLLED_RAD = 0.3, 0.05
_PARTS = ((slice(0, 2), 0.3), (slice(2, 3), 0.1))
"""Translation, and turning at the wheels: share of the whole way from which each is judged on its own."""
_NOTHING_M = 1e-9


class Strides:
    """R recordings in strides of one second (S strides): moves by the wheels, and true moves.

    A stride ends at the last block of its second with known ground truth; a stride across a gap does not
    count.
    """

    def __init__(self, blocks: Blocks, geometry: WheelGeometry) -> None:
        self._blocks, self._geometry = blocks, geometry
        self._ends = _ends(blocks)
        self._poses = self._at_ends(np.concatenate([blocks.start[:, None], blocks.truth], axis=1))
        lasts = np.diff(self._ends, axis=1)
        counted = _rolling(blocks, self._ends) & (lasts > 0) & (lasts <= _LONGEST)
        self._weight = counted[..., None] * np.array([1.0, 1.0, lever_m(geometry)])

    def _at_ends(self, rows: Array) -> Array:
        return np.take_along_axis(rows, self._ends[..., None], axis=1)

    def rolled(self, signs: Array | float = 1.0, order: Sequence[int] = (0, 1, 2, 3)) -> Array:
        """Moves (R, S, 3) by nominal odometry, from wheel vectors times signs (8,); columns held `order`."""
        column = np.argsort(order)
        x, y = ((signs * self._blocks.wheel_rad)[..., k::2][..., column] for k in (0, 1))
        radius_m, zero_rad = self._geometry.radius_m, self._geometry.steering_zero_rad
        vectors = wheel_vectors(radius_m * np.hypot(x, y), np.arctan2(y, x) - zero_rad)
        motion = twist_of_vectors(self._geometry, vectors)
        return _moves(self._at_ends(integrate(np.zeros(3), motion)))

    def moved(self, signs: Sequence[float] = (1.0, 1.0, 1.0), order: Sequence[int] = (0, 1, 2)) -> Array:
        """True moves (R, S, 3), with x, y and theta of the poses reordered and multiplied by signs."""
        return _moves(self._poses[..., list(order)] * np.array(signs))

    def missed(self, rolled: Array, moved: Array) -> Array:
        """Share (R,) of the true way or turning, the larger one, that the wheels miss while they roll."""
        return _share(self.counted(rolled), self.counted(moved))

    def counted(self, moves: Array) -> Array:
        """Moves (R, S, 3), m, while the wheels roll, else 0; turning counts at the wheels."""
        return np.asarray(moves * self._weight, dtype=np.float64)


def _ends(blocks: Blocks) -> Rows:
    """Edge indices (R, S + 1) at which the strides of each recording begin and end."""
    edges = np.arange(blocks.known.shape[1] + 1)
    known = np.pad(blocks.known, ((0, 0), (1, 0)), constant_values=True)
    last_known = np.maximum.accumulate(np.where(known, edges, 0), axis=1)
    return np.asarray(last_known[:, ::_STRIDE], dtype=np.int_)


def _rolling(blocks: Blocks, ends: Rows) -> Bools:
    """Mask (R, S) of strides in which the wheels roll; noise at rest does not count."""
    way = np.pad(np.cumsum(blocks.wheel_rad, axis=1), ((0, 0), (1, 0), (0, 0)))
    rolled = np.linalg.norm(np.diff(np.take_along_axis(way, ends[..., None], axis=1), axis=1), axis=2)
    least = np.maximum(_ROLLING * rolled.mean(axis=1, keepdims=True), LEAST_ROLLED_RAD)
    return np.asarray(rolled > least, dtype=np.bool_)


def _share(moves: Array, true: Array) -> Array:
    """Share (R,) of true moves (R, S, 3), m, that other moves miss, in way or turning where these matter."""
    missed, whole = np.zeros(len(true)), _size(true)
    for part, worth in _PARTS:
        way = _size(true[..., part])
        share = _size((moves - true)[..., part]) / way
        missed = np.maximum(missed, np.where((way > worth * whole) & (whole > _NOTHING_M), share, 0.0))
    return missed


def _size(moves: Array) -> Array:
    """Sum (R,) of the lengths of moves (R, S, k)."""
    return np.asarray(np.maximum(np.linalg.norm(moves, axis=2).sum(axis=1), _NOTHING_M), dtype=np.float64)


def _moves(poses: Array) -> Array:
    """Moves (R, S, 3) between consecutive poses (R, S + 1, 3), in the frame of the earlier one."""
    x, y, turn = np.moveaxis(np.diff(poses, axis=1), -1, 0)
    c, s = np.cos(poses[:, :-1, 2]), np.sin(poses[:, :-1, 2])
    return np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)
