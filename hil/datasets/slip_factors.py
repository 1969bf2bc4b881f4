"""Slip factors of a recorded twist: the way that the robot went over the way that its odometry reports.

A twist determines three: along and across the robot, and of its turning. How single wheels slip, it does not
say. Each is a least-squares slope over moves of one second; its uncertainty is that of the slope by what is
left, so slip that changes during the drive widens it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array
from hil.datasets.sensor_moves import moves_by_camera, moves_by_truth, moves_by_wheels, turns_by_gyro
from hil.datasets.wheel_log import Recording

AXES = ("along", "across", "turning")
_LEAST = (0.1, 0.1, 0.3)
"""Root of the summed squares of the reported moves from which a factor is determined: m, m, rad."""
_FEWEST = 3


@dataclass(frozen=True)
class SlipFactors:
    """Factors of a twist; a way without slip has 1.

    Attributes:
        by: reference: ground truth, camera or gyro.
        factors: factor and its standard deviation by axis; None where the drive does not determine it.
    """

    by: str
    factors: dict[str, tuple[float, float] | None]

    def to_json(self) -> dict[str, object]:
        """The factors as plain data."""
        named = {
            axis: None if one is None else {"factor": one[0], "sigma": one[1]}
            for axis, one in self.factors.items()
        }
        return {"by": self.by, "factors": named}


def slip_factors(recordings: Sequence[Recording]) -> SlipFactors | None:
    """Factors of recordings of one robot, by the best reference that all have; None without any.

    Args:
        recordings: recordings of a twist.
    """
    sources = (("ground truth", moves_by_truth), ("camera", moves_by_camera), ("gyro", turns_by_gyro))
    for by, moves_of in sources:
        found = [moves_of(one) for one in recordings]
        if not found or not all(len(moved) for _, moved in found):
            continue
        reported = [
            moves_by_wheels(one, edges_s, one.nominal.geometry)
            for one, (edges_s, _) in zip(recordings, found, strict=True)
        ]
        moved = np.concatenate([moves for _, moves in found])
        slopes = _slopes(np.concatenate(reported), moved, range(2, 3) if by == "gyro" else range(3))
        return SlipFactors(by, slopes)
    return None


def _slopes(reported: Array, moved: Array, axes: range) -> dict[str, tuple[float, float] | None]:
    out: dict[str, tuple[float, float] | None] = dict.fromkeys(AXES)
    for j in axes:
        x, y = reported[:, j], moved[:, j]
        size = float(x @ x)
        if len(x) < _FEWEST or size < _LEAST[j] ** 2:
            continue
        slope = float(x @ y) / size
        left = y - slope * x
        out[AXES[j]] = (slope, float(np.sqrt(left @ left / (len(x) - 1) / size)))
    return out
