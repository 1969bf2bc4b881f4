"""Estimates the clock offset between wheels and ground truth, by cross-correlation of their speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.dataset import Recording
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import LONGEST_GAP_S, interpolate, is_slow, truth_window, wheel_steps
from hil.robot.kinematics import twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

_GRID_S, _WINDOW_S = 0.02, 0.2
_ALIKE = 0.9
_WORTH_S, _UNSURE = 0.03, 0.1
_GAPS_LONGER = 1.5


def time_offset_s(recording: Recording) -> float | None:
    """Delay of the ground truth behind the wheels, s; None where their speeds are too different.

    The delay is the maximum of the cross-correlation of the speeds. Motion at both ends of a recording makes
    it too small.
    """
    at_s, pose = truth_window(recording)
    grid_s = np.arange(at_s[0], at_s[-1], _GRID_S)
    n = round(_WINDOW_S / _GRID_S)
    moved, rolled = (
        values[n:] - values[:-n]
        for values in (
            interpolate(grid_s, at_s, pose),
            interpolate(grid_s, recording.t_s, _by_wheels(recording)),
        )
    )
    lever = lever_m(recording.nominal.geometry)
    known = _known(grid_s, at_s)
    truth, wheels = (_lengths(moves, lever) * (known[n:] & known[:-n]) for moves in (moved, rolled))
    size = float(np.linalg.norm(truth) * np.linalg.norm(wheels))
    count = 2 * len(truth)
    overlap = np.fft.irfft(np.fft.rfft(truth, count) * np.fft.rfft(wheels[::-1], count), count)[:-1]
    best = int(np.argmax(overlap))
    if size == 0.0 or overlap[best] < _ALIKE * size or not 0 < best < len(overlap) - 1:
        return None
    delay_s = float((best - len(wheels) + 1 + _peak_offset(overlap[best - 1 : best + 2])) * _GRID_S)
    return _refined_s(recording, delay_s) if is_slow(at_s) else delay_s


def _refined_s(recording: Recording, about_s: float) -> float:
    """Delay of slow ground truth near `about_s` by which the wheels move the same between its rows, s.

    Between slow rows the interpolated speed is a mean, and its cross-correlation is off by a part of their
    period. So the way of the wheels is taken between the same rows, delayed.
    """
    at_s, pose = truth_window(recording)
    lasts_s = np.diff(at_s)
    typical_s = float(np.median(lasts_s))
    whole = lasts_s <= _GAPS_LONGER * typical_s
    span_s = max(_WINDOW_S, typical_s)
    delays_s = about_s + np.arange(-round(span_s / _GRID_S), round(span_s / _GRID_S) + 1) * _GRID_S
    rolled, lever = _by_wheels(recording), lever_m(recording.nominal.geometry)
    moved = _lengths(np.diff(pose, axis=0), lever)
    grid = (interpolate(at_s - late_s, recording.t_s, rolled) for late_s in delays_s.tolist())
    ways = (_lengths(np.diff(shifted, axis=0), lever) for shifted in grid)
    misses = np.array([np.sum((way - moved)[whole] ** 2) for way in ways])
    best = int(np.clip(np.argmin(misses), 1, len(misses) - 2))
    part = float(np.clip(_peak_offset(-misses[best - 1 : best + 2]), -1.0, 1.0))
    return float(delays_s[best] + part * _GRID_S)


def _peak_offset(values: Array) -> float:
    """Peak of the parabola through three values, in steps from the middle one; 0 without a peak."""
    before, middle, after = values
    bend = before - 2.0 * middle + after
    return float(0.5 * (before - after) / bend) if bend < 0.0 else 0.0


def _lengths(moves: Array, lever: float) -> Array:
    """Lengths (n,) of moves (n, 3), m, with turns at the distance `lever`."""
    return np.asarray(np.hypot(moves[:, 0], moves[:, 1]) + lever * np.abs(moves[:, 2]), dtype=np.float64)


def _by_wheels(recording: Recording) -> Array:
    """Poses (n, 3) at the wheel rows by nominal odometry, started at zero."""
    wheels = recording.nominal.geometry
    rotation, steering = wheel_steps(recording, recording.t_s, "position")
    vectors = wheel_vectors(rotation * wheels.radius_m, steering - wheels.steering_zero_rad)
    return integrate(np.zeros(3), twist_of_vectors(wheels, vectors, "exact"))


def _known(grid_s: Array, at_s: Array) -> Bools:
    """Mask of instants (k,) at which the ground truth, rows (m,), has no gap."""
    lasts_s = np.diff(at_s)
    longest_s = max(LONGEST_GAP_S, _GAPS_LONGER * float(np.median(lasts_s)))
    behind = np.clip(np.searchsorted(at_s, grid_s), 1, len(at_s) - 1)
    return np.asarray(lasts_s[behind - 1] <= longest_s, dtype=np.bool_)


def _worth_s(recording: Recording) -> float:
    """Least offset to report, s."""
    at_s = recording.truth_t_s
    return _WORTH_S + (_UNSURE * float(np.median(np.diff(at_s))) if is_slow(at_s) else 0.0)


def different_clocks(recordings: Sequence[Recording]) -> list[str]:
    """One line if the median offset of ground truth and wheels is 0.03 s or more; else none.

    Where the ground truth is slow, a tenth of its period is added, to which its offset is known.
    """
    known = [(offset_s, _worth_s(one)) for one in recordings if (offset_s := time_offset_s(one)) is not None]
    found, worth_s = zip(*known, strict=True) if known else ((0.0,), (_WORTH_S,))
    typical_s = float(np.median(found))
    if abs(typical_s) < float(np.median(worth_s)):
        return []
    word = "later" if typical_s > 0 else "earlier"
    return [
        f"the ground truth moves {abs(typical_s):.2f} s {word} than the wheels (median of {len(found)} "
        "recordings), which a fit takes for wrong radii; bring both to one clock"
    ]
