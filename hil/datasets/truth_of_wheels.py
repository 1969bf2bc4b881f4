"""Finds ground truth that was computed from the wheels, or in part: it shows nothing that they do not know.

Odometry of any geometry is a linear function of the wheel vectors. What a measured path leaves beside the
best such function is at least the noise of the capture system and the rounding of the encoders: 10 um
together, where either is far better than usual. A path that was integrated from these very wheel angles
leaves what its file rounds.

Where odometry was mixed in, as by a filter that takes both, the ground truth repeats a share of the rounding
of the encoders. It is seen in fourth differences of the path. Those of the wheel angles are compared with
those of smoothed angles that are rounded alike: what is more may be a tremble, which the truth follows too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import is_slow, truth_window, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import twist_of_vectors, wheel_vectors

_STRIDE_S, _FEWEST = 0.2, 24
_ROLLED_M = 1e-4
_MEASURED_M = 4e-6
"""Least deviation that a measured path has from one by the wheels, m, in strides of 0.2 s."""
_SHARE, _STDS, _OUTLIERS, _FEWEST_ROWS, _MORE = 0.2, 5.0, 6.0, 200, 0.15
_DIFFERENCES, _SMOOTHED, _SERIAL = 4, 25, 4.0
"""Order of the differences, rows of the smoothing, and by how much overlap increases the variance."""
_LEAST_COUNT_RAD, _ROLLS, _NOTHING = 1e-5, 0.3, 1e-9
_MIXED = (
    "its ground truth repeats {:.2f} of the rounding of the wheel angles: odometry was mixed into it "
    "(a filter that takes both?); take the poses of the capture system alone"
)
_MAYBE = (
    "ground truth follows the smallest steps of the wheel angles, by {:.2f} ({}): the robot trembles with "
    "its wheels, or odometry was mixed into it; recordings cannot tell these apart"
)


def of_wheels(recording: Recording) -> str:
    """A sentence where the ground truth was computed from the wheels of its recording; else empty."""
    left_m = _left_m(recording)
    if left_m > _MEASURED_M:
        return ""
    return (
        f"its ground truth was computed from these wheel angles: it deviates by {1e6 * left_m:.1f} um from "
        f"what they give, and a measured one by {1e6 * _MEASURED_M:.0f} um at least; nothing can be "
        "calibrated on odometry: take the poses of a capture system"
    )


def with_odometry_in_truth(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name ground truth that repeats the rounding of the wheel angles.

    A share of 0.2, five times its standard error, is found in a recording, or in all of them together where
    noise hides it in one. Where the robot may tremble as much, `notes` say so.
    """
    found = [_repeated(one) for one in recordings]
    alone = [k for k, own in enumerate(found) if _share(own)]
    together = np.sum([own for k, own in enumerate(found) if k not in alone] or [np.zeros(5)], axis=0)
    out, maybe = list(recordings), list[tuple[str, float]]()
    for k, (one, own) in enumerate(zip(recordings, found, strict=True)):
        sums = own if k in alone else together
        share = _share(sums) if own.any() else 0.0
        if share > _trembles(sums) + _MORE:
            out[k] = one.contradicted(_MIXED.format(share))
        elif share:
            maybe.append((one.name, share))
    if maybe:
        names = f"{maybe[0][0]} and {len(maybe) - 1} more" if len(maybe) > 1 else maybe[0][0]
        note = _MAYBE.format(float(np.median([share for _, share in maybe])), names)
        out[0] = replace(out[0], notes=(*out[0].notes, note))
    return out


def _share(sums: Array) -> float:
    """The share by the sums of `_repeated`; 0 where it is not clear."""
    along, size, spread = sums[:3]
    if size <= 0.0 or along < max(_SHARE * size, _STDS * float(np.sqrt(spread))):
        return 0.0
    return float(along / size)


def _trembles(sums: Array) -> float:
    """Share of the wheels' smallest steps that rounding does not explain, by the sums of `_repeated`."""
    return max(0.0, 1.0 - float(sums[4] / max(sums[3], _NOTHING**2)))


def _repeated(one: Recording) -> Array:
    """Sums (5,) over fourth differences of the path; zeros where the wheels do not round.

    Truth times wheels, wheels squared, the variance of the first; of the wheel angles squared, and of
    smoothed ones that are rounded alike.
    """
    at_s, pose = truth_window(one)
    if one.of_twist or one.contradictions or len(at_s) < _FEWEST_ROWS or is_slow(at_s) or of_wheels(one):
        return np.zeros(5)
    rotation, steering = wheel_steps(one, at_s, "position")
    wheels = one.nominal.geometry
    by_wheels = twist_of_vectors(wheels, wheel_vectors(rotation * wheels.radius_m, steering))[:, :2]
    rolled, moved = (np.diff(s, n=_DIFFERENCES - 1, axis=0) for s in (by_wheels, _steps(pose, one)[:, :2]))
    kept = _usual(rolled) & _usual(moved)
    rolled, moved = rolled[kept], moved[kept]
    angle, rounded = _rounded(one.wheel_angle_rad)
    if len(rolled) < _FEWEST_ROWS or len(angle) == 0:
        return np.zeros(5)
    spread = _SERIAL * float(rolled**2 @ moved**2)
    return np.array([rolled @ moved, rolled @ rolled, spread, angle @ angle, rounded @ rounded])


def _rounded(angle: Array) -> tuple[Array, Array]:
    """Fourth differences (k,) of wheel angles (n, 4) that roll, and of smoothed ones rounded alike."""
    steps = np.abs(np.diff(angle, axis=0))
    count_rad = float(steps.min(where=steps > _LEAST_COUNT_RAD, initial=np.inf))
    if len(angle) < 4 * _SMOOTHED or not np.isfinite(count_rad):
        return np.empty(0), np.empty(0)
    mean = np.ones(_SMOOTHED) / _SMOOTHED
    smooth = np.column_stack([np.convolve(np.convolve(c, mean, "valid"), mean, "valid") for c in angle.T])
    own = angle[_SMOOTHED - 1 : 1 - _SMOOTHED]
    pair = [np.diff(a, n=_DIFFERENCES, axis=0) for a in (own, np.round(smooth / count_rad) * count_rad)]
    rolls = np.abs(np.diff(smooth, axis=0))[: len(pair[0])] > _ROLLS * count_rad
    kept = rolls & _usual(pair[0])
    return pair[0][kept], pair[1][kept]


def _usual(values: Array) -> Bools:
    """Mask (n, k) of values without those far beyond the median of their column."""
    size = np.abs(values)
    return np.asarray(size < _OUTLIERS * np.maximum(np.median(size, axis=0), _NOTHING), dtype=np.bool_)


def _left_m(recording: Recording) -> float:
    """Deviation, m, root mean square at the wheels, of moves over 0.2 s; infinite where there are too few."""
    at_s, pose = truth_window(recording)
    if len(at_s) < 2 or is_slow(at_s):
        return np.inf
    rotation, steering = wheel_steps(recording, at_s, "position")
    u = wheel_vectors(rotation * recording.nominal.geometry.radius_m, steering).reshape(len(rotation), 8)
    rows = np.flatnonzero(np.diff(np.floor((at_s - at_s[0]) / _STRIDE_S), prepend=-1.0))[:-1]
    rolled, moved = (np.add.reduceat(steps, rows, axis=0) for steps in (u, _steps(pose, recording)))
    rolls = np.abs(rolled).max(axis=1) > _ROLLED_M
    if np.count_nonzero(rolls) < _FEWEST:
        return np.inf
    rolled, moved = rolled[rolls], moved[rolls]
    left = moved - rolled @ np.linalg.lstsq(rolled, moved, rcond=1e-4)[0]
    return float(np.sqrt(np.mean(left**2)))


def _steps(pose: Array, recording: Recording) -> Array:
    """Steps (n - 1, 3), m, of poses (n, 3) in the body's frame: ahead, left, turned at the wheels."""
    x, y, turn = np.diff(pose, axis=0).T
    moved = (x + 1j * y) * np.exp(-0.5j * (pose[1:, 2] + pose[:-1, 2]))
    return np.stack([moved.real, moved.imag, lever_m(recording.nominal.geometry) * turn], axis=1)
