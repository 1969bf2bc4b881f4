"""Recordings reduced to what a fit needs: wheel vectors per block of time, truth at the block ends.

Two facts make a fit quick: the wheel vectors dphi (cos d, sin d)
do not depend on the parameters, and increments may be summed to blocks of 0.1 s, because the SE(2)
exponential takes care of the chord. Recordings are padded to one length so that all of them are
integrated in one call; a padded block does not move the robot and has no weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.calibration.datasets import Recording
from hil.calibration.evaluation import block_vectors, interpolate, rest_pose, truth_window
from hil.vocabulary.geometry import Array


@dataclass(frozen=True)
class Blocks:
    """R recordings of up to N blocks.

    Attributes:
        names, motions: of each recording.
        wheel_rad: (R, N, 8) dphi_i cos d_i, dphi_i sin d_i summed over the block, rad.
        truth: (R, N, 3) pose at the end of the block; `start` (R, 3) pose at the first one's start.
        counts: (R,) number of real blocks.
    """

    names: tuple[str, ...]
    motions: tuple[str, ...]
    wheel_rad: Array
    truth: Array
    start: Array
    counts: Array
    block_s: float

    @property
    def mask(self) -> Array:
        """(R, N), 1 for a real block and 0 for padding."""
        index = np.arange(self.wheel_rad.shape[1])
        return np.asarray(index[None, :] < self.counts[:, None], dtype=np.float64)

    def subset(self, index: Sequence[int]) -> Blocks:
        """Some of the recordings."""
        i = list(index)
        counts = self.counts[i]
        n = int(counts.max())
        return Blocks(
            tuple(self.names[k] for k in i),
            tuple(self.motions[k] for k in i),
            np.ascontiguousarray(self.wheel_rad[i][:, :n]),
            np.ascontiguousarray(self.truth[i][:, :n]),
            self.start[i],
            counts,
            self.block_s,
        )


def reduce_recordings(recordings: Sequence[Recording], block_s: float, signal: str = "position") -> Blocks:
    """Sum wheel increments to blocks of `block_s` seconds.

    Args:
        recordings: to reduce.
        block_s: length of a block, s.
        signal: `position` or `velocity`: which wheel signal is summed.
    """
    rows = [_reduced(r, block_s, signal) for r in recordings]
    counts = np.array([len(w) for w, _, _ in rows])
    n = int(counts.max())
    wheel, truth = np.zeros((len(rows), n, 8)), np.zeros((len(rows), n, 3))
    for k, (w, t, _) in enumerate(rows):
        wheel[k, : len(w)], truth[k, : len(t)] = w, t
    return Blocks(
        tuple(r.name for r in recordings),
        tuple(r.motion for r in recordings),
        wheel,
        truth,
        np.array([s for _, _, s in rows]),
        counts,
        block_s,
    )


def _reduced(recording: Recording, block_s: float, signal: str) -> tuple[Array, Array, Array]:
    """Wheel vectors, poses at the blocks' ends and pose at the start of a recording."""
    key = ("reduced", block_s, signal)
    if key not in recording.derived:
        recording.derived[key] = _reduce(recording, block_s, signal)
    found: tuple[Array, Array, Array] = recording.derived[key]
    return found


def _reduce(recording: Recording, block_s: float, signal: str) -> tuple[Array, Array, Array]:
    truth_s, _ = truth_window(recording)
    count = max(1, int((truth_s[-1] - truth_s[0]) / block_s))
    edges_s = truth_s[0] + np.arange(count + 1) * block_s
    wheel = block_vectors(recording, edges_s, signal)
    truth = interpolate(edges_s[1:], recording.truth_t_s, recording.truth_pose)
    return wheel, truth, rest_pose(recording)
