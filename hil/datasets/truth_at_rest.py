"""Finds ground truth that moves while the robot rests: a frame that drifts, or a robot that slides.

While no wheel turns nothing but the frame of the capture system, or a slide of the whole robot, moves the
poses. Each rest gives a speed, by a line through means of its rows, with a standard error from what the line
leaves, and from the noise of the whole recording. Noise that changes slowly is in that error, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array
from hil.datasets.sampling import interpolate
from hil.datasets.truth_deviations import significant
from hil.datasets.truth_noise import white_noise
from hil.datasets.wheel_log import Recording

_GRID_S, _LEAST_S = 0.1, 0.5
_WHEEL_RAD, _STEERING_RAD, _ROLLED_RAD = 4e-3, 0.01, 0.012
"""Turns over 0.1 s, and of a wheel over the whole rest, that rounding and dither explain."""
_SETTLES_S, _BEFORE_S, _LEAST_USED_S = 0.5, 0.15, 0.25
"""Time after a stop in which tyres relax, before a start, and the least that is left to measure a speed."""
_ROWS, _MEANS, _FEWEST, _SPREAD = 7, 10, 4, 4.0
_FLOOR = np.array([5e-6, 5e-6, 2e-5])
"""Least standard error of a speed, m/s, m/s, rad/s: rests of good recordings differ by as much."""
_COMMON, _COMMON_STD = np.array([1e-4, 1e-4, 7e-5]), np.array([1e-4, 1e-4, 2e-4])
_ALONE, _ALONE_STDS, _ONLY = np.array([2.5e-4, 2.5e-4, 3e-4]), 5.0, 2.0
_MOTION = np.array([5e-3, 5e-3, 0.03])
FRAME_OR_SLIDE = (
    "either the frame of the capture system moves (a tripod that sinks, a camera that turns), or the robot "
    "slides; recordings cannot tell these apart. Fasten the cameras, or hold the robot"
)


@dataclass(frozen=True)
class _Rest:
    """Ground truth in a rest.

    Attributes:
        speed: (3,) speed, m/s, m/s, rad/s.
        std: (3,) its standard errors.
        lasts_s: length, s.
        behind: whether the robot drove before it.
    """

    speed: Array
    std: Array
    lasts_s: float
    behind: bool


def with_truth_at_rest(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name ground truth that moves while no wheel turns.

    In a set it is named from 0.1 mm/s or 0.07 mrad/s on, four standard errors of all rests together, or of
    those behind the drives: a drift may begin with the motion, and a robot slides where it came to. In a
    single recording from 0.25 mm/s or 0.3 mrad/s on, if each of its rests shows five standard errors, or an
    only one ten.
    """
    found = [
        [] if one.contradictions else [rest for rows in rests(one) for rest in _measured(one, *rows)]
        for one in recordings
    ]
    every = [rest for own in found for rest in own]
    for some, where in ((every, "of the set"), ([r for r in every if r.behind], "behind a drive")):
        common = np.array([_common(some, k) for k in range(3)])
        if common.any():
            said = f"{_in_words(common)} (all {len(some)} rests {where}): {FRAME_OR_SLIDE}"
            return [one.contradicted(said) for one in recordings]
    out = []
    for one, own in zip(recordings, found, strict=True):
        alone = _alone(own)
        said = f"{_in_words(alone)} ({_count(own)}): {FRAME_OR_SLIDE}"
        out.append(one.contradicted(said) if alone.any() else one)
    return out


def _common(rests: Sequence[_Rest], k: int) -> float:
    measured = [(complex(rest.speed[k]), float(rest.std[k])) for rest in rests]
    return float(significant(measured, float(_COMMON[k]), float(_COMMON_STD[k])).real)


def _alone(rests: Sequence[_Rest]) -> Array:
    """Speed (3,) that all rests of one recording show, the least one of each axis; 0 where one does not."""
    if not rests:
        return np.zeros(3)
    speeds, stds = np.array([rest.speed for rest in rests]), np.array([rest.std for rest in rests])
    least_stds = _ALONE_STDS * (1.0 if len(rests) > 1 else _ONLY)
    clear = (np.abs(speeds) > np.maximum(_ALONE, least_stds * stds)).all(axis=0)
    clear &= np.abs(np.sign(speeds).sum(axis=0)) == len(rests)
    least = np.take_along_axis(speeds, np.abs(speeds).argmin(axis=0)[None], axis=0)[0]
    return np.where(clear, least, 0.0)


def _in_words(speed: Array) -> str:
    sizes = []
    if speed[:2].any():
        sizes.append(f"moves by {1e3 * np.hypot(*speed[:2]):.2f} mm/s")
    if speed[2]:
        sizes.append(f"turns by {1e3 * speed[2]:.2f} mrad/s")
    return f"its ground truth {' and '.join(sizes)} while no wheel turns"


def _count(rests: Sequence[_Rest]) -> str:
    lasts_s = sum(rest.lasts_s for rest in rests)
    return f"{len(rests)} rest{'s' if len(rests) > 1 else ''}, {lasts_s:.1f} s"


def rests(one: Recording) -> list[tuple[Array, Array]]:
    """Times (n,), s, and poses (n, 3) in the rests of a recording. Cached.

    The time in which tyres relax is left out.
    """
    if "rests" not in one.derived:
        one.derived["rests"] = _rests(one)
    return cast("list[tuple[Array, Array]]", one.derived["rests"])


def _rests(one: Recording) -> list[tuple[Array, Array]]:
    if not one.has_truth or one.of_twist:
        return []
    grid_s = np.arange(one.t_s[0], one.t_s[-1], _GRID_S)
    angles = interpolate(grid_s, one.t_s, np.hstack([one.wheel_angle_rad, one.steering_rad]))
    steps = np.abs(np.diff(angles, axis=0)) < np.repeat([_WHEEL_RAD, _STEERING_RAD], 4)
    still = np.asarray(steps.all(axis=1), dtype=np.bool_)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int_), [0]]))).reshape(-1, 2)
    out = []
    for begin, end in ends.tolist():
        if end - begin < round(_LEAST_S / _GRID_S):
            continue
        if float(np.ptp(angles[begin : end + 1, :4], axis=0).max()) > _ROLLED_RAD:
            continue
        begin_s = grid_s[begin] + (_SETTLES_S if begin else 0.0)
        end_s = grid_s[end] - _BEFORE_S if end < len(still) else one.t_s[-1]
        rows = (one.truth_t_s >= begin_s) & (one.truth_t_s <= end_s)
        if end_s - begin_s >= _LEAST_USED_S and np.count_nonzero(rows) >= _ROWS:
            out.append((one.truth_t_s[rows], one.truth_pose[rows]))
    return out


def _measured(one: Recording, at_s: Array, pose: Array) -> list[_Rest]:
    """The speed of poses (n, 3) at times (n,), s; none where it changes, or is that of a motion.

    So it is where the clock of the ground truth is late or early.
    """
    means = min(_MEANS, max(_FEWEST, len(at_s) // 5))
    t_s, values = (
        np.array([part.mean(axis=0) for part in np.array_split(rows, means)]) for rows in (at_s, pose)
    )
    speed, std = _line(t_s, values)
    by_noise = white_noise(one) / np.sqrt(np.sum((at_s - at_s.mean()) ** 2))
    std = np.maximum.reduce([std, _line(at_s, pose)[1], by_noise])
    half = means // 2
    halves = [_line(t_s[part], values[part])[0] for part in (slice(0, half), slice(means - half, means))]
    spread = _SPREAD * std * (means / half) ** 1.5
    changes = np.abs(halves[1] - halves[0]) > np.maximum(spread, np.abs(speed))
    if np.any(changes | (np.abs(speed) > _MOTION)):
        return []
    before = one.wheel_angle_rad[one.t_s <= at_s[0]]
    behind = len(before) > 0 and float(np.ptp(before, axis=0).max()) > _ROLLED_RAD
    return [_Rest(speed, np.maximum(std, _FLOOR), float(at_s[-1] - at_s[0]), behind)]


def _line(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Slopes (k,) of lines through values (n, k) at times (n,), and their standard errors."""
    since = t_s - t_s.mean()
    size = float(since @ since)
    slope = since @ (values - values.mean(axis=0)) / size
    left = values - values.mean(axis=0) - since[:, None] * slope
    std = np.sqrt((left**2).sum(axis=0) / max(len(t_s) - 2, 1) / size)
    return np.asarray(slope), np.asarray(std)
