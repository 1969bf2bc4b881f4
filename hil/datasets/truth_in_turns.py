"""Finds a frame of the ground truth that drifts in a set whose recordings never rest.

On a path on which the body turns, a drift of the frame turns against the body, and nothing that the wheels do
turns so. A slide down a wall does: the two cannot be told apart.
"""

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array
from hil.datasets.truth_at_rest import FRAME_OR_SLIDE, rests
from hil.datasets.truth_deviations import significant
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_TURNED_RAD, _FEWEST, _ROUNDS, _USUAL = 5.0, 16, 6, 1.5
_SPEED_M_S, _STD_M_S, _SERIAL, _NOTHING_M = 3e-4, 3e-4, 3.0, 1e-9
"""Speed that is named, largest standard error, and by how much slip, which lasts, increases the latter."""


def with_truth_in_turns(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name a drift from 0.3 mm/s on, where no recording rests."""
    known = [one for one in recordings if not one.contradictions]
    if not known or any(rests(one) for one in known):
        return list(recordings)
    measured = [own for one in known if (own := drift_m_s(one)) is not None]
    common = significant(measured, _SPEED_M_S, _STD_M_S)
    if not common:
        return list(recordings)
    said = (
        f"its ground truth drifts by {1e3 * abs(common):.2f} mm/s beside the wheels while the body turns "
        f"({len(measured)} recordings, of which none rests): {FRAME_OR_SLIDE}"
    )
    return [one.contradicted(said) for one in recordings]


def drift_m_s(one: Recording) -> tuple[complex, float] | None:
    """Speed x + iy of the frame, m/s, and its standard error; None where the body hardly turns.

    Ways of the middle of the wheels over half a second are fitted by what the wheels say, scaled and turned,
    and by a steady speed of the frame. Stretches in which the robot slips count less (Huber's weights).
    """
    own = Stretches.of(one)
    if own is None or len(own.at_s) < _FEWEST or np.ptp(own.heading_rad) < _TURNED_RAD:
        return None
    way, wanted = own.rolled.mean(axis=1), own.moved.mean(axis=1)
    rows = np.column_stack([way, np.exp(-1j * own.heading_rad) * own.lasts_s, np.ones_like(way)])
    left, weight = wanted - way, np.ones(len(way))
    for _ in range(_ROUNDS):
        by = weight[:, None]
        x: Array = np.linalg.lstsq(rows * by, wanted * weight, rcond=None)[0]
        left = wanted - rows @ x
        usual = max(float(np.median(np.abs(left))), _NOTHING_M)
        weight = np.sqrt(np.minimum(1.0, _USUAL * usual / np.maximum(np.abs(left), _NOTHING_M)))
    information = np.linalg.inv(np.conj(rows * by).T @ (rows * by) + 1e-12 * np.eye(3)).real
    spread = float(np.mean(np.abs(left * weight) ** 2))
    return complex(x[1]), _SERIAL * float(np.sqrt(spread * information[1, 1]))
