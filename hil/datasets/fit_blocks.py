"""Reduces recordings to the data for a fit: wheel vectors per block of time, truth at the block ends.

Two facts make a fit fast. The wheel vectors dphi (cos d, sin d) do not depend on the parameters; and
increments may be summed to blocks of 0.1 s, because the SE(2) exponential accounts for the chord. Recordings
are padded to one length so that all of them are integrated in one call; a padded block does not move the
robot and has no weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.sampling import block_vectors, checked_edges
from hil.datasets.start_pose import start_of
from hil.datasets.wheel_log import Recording


@dataclass(frozen=True)
class Blocks:
    """Blocks of R recordings, up to N each.

    Attributes:
        names, motions: name and motion of each recording.
        wheel_rad: (R, N, 8) dphi_i cos d_i, dphi_i sin d_i summed over the block, rad.
        truth: (R, N, 3) pose at the end of the block; `start` (R, 3) pose at the start of the first block.
        counts: (R,) number of real blocks.
        known: (R, N) whether ground truth is known at the end of the block; False for padding.
        block_s: typical length of a block, s.
    """

    names: tuple[str, ...]
    motions: tuple[str, ...]
    wheel_rad: Array
    truth: Array
    start: Array
    counts: Array
    known: Bools
    block_s: float

    @property
    def real(self) -> Bools:
        """(R, N), True for a real block and False for padding."""
        return np.asarray(np.arange(self.wheel_rad.shape[1])[None, :] < self.counts[:, None], dtype=np.bool_)

    @property
    def mask(self) -> Array:
        """(R, N), 1 where the end of the block is compared and 0 elsewhere."""
        return np.asarray(self.known, dtype=np.float64)

    @property
    def compared(self) -> Array:
        """(R,) number of blocks whose ends are compared."""
        return np.asarray(self.mask.sum(axis=1), dtype=np.float64)

    def subset(self, index: Sequence[int]) -> Blocks:
        """The blocks of some of the recordings."""
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
            np.ascontiguousarray(self.known[i][:, :n]),
            self.block_s,
        )


def reduce_recordings(recordings: Sequence[Recording], block_s: float, signal: str = "position") -> Blocks:
    """Sum wheel increments to blocks of `block_s` seconds.

    Args:
        recordings: recordings to reduce.
        block_s: length of a block, s.
        signal: `position` or `velocity`: which wheel signal is summed.
    """
    rows = [_reduced(r, block_s, signal) for r in recordings]
    counts = np.array([len(w) for w, _, _ in rows])
    n = int(counts.max())
    wheel, truth = np.zeros((len(rows), n, 8)), np.zeros((len(rows), n, 3))
    known = np.zeros((len(rows), n), dtype=np.bool_)
    for k, (w, t, seen) in enumerate(rows):
        wheel[k, : len(w)], truth[k, : len(t)], known[k, : len(t)] = w, t, seen
    return Blocks(
        tuple(r.name for r in recordings),
        tuple(r.motion for r in recordings),
        wheel,
        truth,
        np.array([start_of(r).pose for r in recordings]),
        counts,
        known,
        block_s,
    )


def _reduced(recording: Recording, block_s: float, signal: str) -> tuple[Array, Array, Bools]:
    """Wheel vectors, poses at the blocks' ends, and whether these are known, of a recording; cached."""
    key = ("reduced", block_s, signal)
    if key not in recording.derived:
        edges_s, truth, known = checked_edges(recording, block_s)
        recording.derived[key] = block_vectors(recording, edges_s, signal), truth, known
    found: tuple[Array, Array, Bools] = recording.derived[key]
    return found
