"""Whether wheels and ground truth count the same way round, told by where both say the robot went.

A fit cannot mend a wrong sign: all its parameters would end at their bounds. It is named instead, from second
to second and in the robot's own frame, so that neither drift nor a leap decides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.calibration.blocks import Blocks, reduce_recordings
from hil.calibration.datasets import Recording
from hil.calibration.motion_models import make_model
from hil.calibration.nominal import Nominal, lever_m
from hil.robot.kinematics import WheelGeometry
from hil.robot.odometry import integrate
from hil.vocabulary.errors import DataError
from hil.vocabulary.geometry import Array

_BLOCK_S, _STRIDE = 0.1, 10
_WRONG, _RIGHT = 0.6, 0.3
_AGAINST = -0.5
_MIRRORED = np.tile([1.0, -1.0], 4)


def check_signs(recordings: Sequence[Recording], nominal: Nominal) -> None:
    """Refuse recordings whose wheels contradict the ground truth, and would not with another sign.

    A recording counts where its wheels miss more than 0.6 of the true way, and less than 0.3 with the sign
    changed: no geometry, slip or noise does both. Raises `DataError`.
    """
    missed = _missed(reduce_recordings(recordings, _BLOCK_S), nominal.geometry)
    as_is = missed.pop("")
    explained = {words: (as_is > _WRONG) & (share < _RIGHT) for words, share in missed.items()}
    best = max(np.count_nonzero(found) for found in explained.values())
    if not best:
        for one in recordings:
            _check_rates(one)
        return
    likely = [words for words, found in explained.items() if np.count_nonzero(found) == best]
    names = [_place(one) for one, wrong in zip(recordings, explained[likely[0]], strict=True) if wrong]
    others = f" ({len(names) - 1} more recordings likewise)" if len(names) > 1 else ""
    raise DataError(
        names[0],
        f"the wheels contradict the ground truth, and would agree if {', or if '.join(likely)}{others}",
        expected="phi that grows as its wheel rolls forward; delta and theta counter-clockwise from above",
        remedy="change that sign in the file",
    )


def _place(recording: Recording) -> str:
    return recording.sources[0] if recording.sources else recording.name


def _check_rates(recording: Recording) -> None:
    """Refuse wheel rates of the other sign than the wheel angles."""
    if not recording.has_rates:
        return
    grid_s = np.arange(recording.t_s[0], recording.t_s[-1], 1.0)
    ways = [np.diff(np.interp(grid_s, recording.t_s, angle)) for angle in recording.wheel_angle_rad.T]
    middle_s = 0.5 * (grid_s[1:] + grid_s[:-1])
    rates = [np.interp(middle_s, recording.t_s, rate) for rate in recording.wheel_rate_rad_s.T]
    alike = float(np.vdot(ways, rates))
    if alike < _AGAINST * float(np.linalg.norm(ways) * np.linalg.norm(rates)):
        raise DataError(
            _place(recording),
            "the wheel rates (w) have the other sign than the wheel angles (phi)",
            expected="both grow as the wheel rolls forward",
            remedy="change the sign of one in the file",
        )


def _missed(blocks: Blocks, nominal: WheelGeometry) -> dict[str, Array]:
    """Share of the true way (R,) that the wheels miss, as they are ("") and by what would have to change."""
    weight = np.array([1.0, 1.0, lever_m(nominal)])
    strides = blocks.wheel_rad.shape[1] // _STRIDE
    ends = _STRIDE * np.arange(strides + 1)
    whole = (ends[1:] <= blocks.counts[:, None])[..., None] * weight
    poses = np.concatenate([blocks.start[:, None], blocks.truth], axis=1)[:, ends]
    true, clockwise = _moves(poses), _moves(poses * (1.0, 1.0, -1.0))
    wheels, back, turned = (
        _rolled(blocks.wheel_rad * signs, nominal, strides) for signs in (1.0, -1.0, _MIRRORED)
    )
    pairs = {
        "": (wheels, true),
        "the wheel angles (phi) had the other sign": (back, true),
        "the steering (delta) had the other sign": (turned, true),
        "the heading (theta) had the other sign": (wheels, clockwise),
        "y and the heading (theta) had the other sign": (wheels, true * (1.0, -1.0, -1.0)),
        "the heading (theta) were half a turn further": (wheels, true * (-1.0, -1.0, 1.0)),
    }  # fmt: skip
    return {
        words: _size((one - other) * whole) / _size(other * whole) for words, (one, other) in pairs.items()
    }


def _size(moves: Array) -> Array:
    """Sum (R,) of the lengths of moves (R, S, 3)."""
    return np.asarray(np.maximum(np.linalg.norm(moves, axis=2).sum(axis=1), 1e-9), dtype=np.float64)


def _moves(poses: Array) -> Array:
    """Moves (R, S, 3) between poses (R, S + 1, 3), in the frame of the first of both."""
    x, y, turn = np.moveaxis(np.diff(poses, axis=1), -1, 0)
    c, s = np.cos(poses[:, :-1, 2]), np.sin(poses[:, :-1, 2])
    return np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)


def _rolled(wheel_rad: Array, nominal: WheelGeometry, strides: int) -> Array:
    """Moves (R, S, 3) by nominal odometry of wheel vectors (R, N, 8)."""
    used = wheel_rad[:, : strides * _STRIDE]
    motion = make_model("exact", used.reshape(-1, 8), nominal).motion(nominal.vector())
    return integrate(np.zeros(3), motion.reshape(len(used), strides, _STRIDE, 3))[..., -1, :]
