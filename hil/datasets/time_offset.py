"""Estimates the clock offset between wheels and ground truth, by cross-correlation of their speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.dataset import Recording
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import LONGEST_GAP_S, interpolate, truth_window, wheel_steps
from hil.robot.kinematics import twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

_GRID_S, _WINDOW_S = 0.02, 0.2
_ALIKE = 0.9
_WORTH_S = 0.03
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
    truth, wheels = (
        (np.hypot(way[:, 0], way[:, 1]) + lever * np.abs(way[:, 2])) * (known[n:] & known[:-n])
        for way in (moved, rolled)
    )
    size = float(np.linalg.norm(truth) * np.linalg.norm(wheels))
    count = 2 * len(truth)
    overlap = np.fft.irfft(np.fft.rfft(truth, count) * np.fft.rfft(wheels[::-1], count), count)[:-1]
    best = int(np.argmax(overlap))
    if size == 0.0 or overlap[best] < _ALIKE * size or not 0 < best < len(overlap) - 1:
        return None
    before, top, after = overlap[best - 1 : best + 2]
    bend = before - 2.0 * top + after
    part = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float((best - len(wheels) + 1 + part) * _GRID_S)


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


def different_clocks(recordings: Sequence[Recording]) -> list[str]:
    """One line if the median offset of ground truth and wheels is 0.03 s or more; else none."""
    found = [offset_s for one in recordings if (offset_s := time_offset_s(one)) is not None]
    typical_s = float(np.median(found)) if found else 0.0
    if abs(typical_s) < _WORTH_S:
        return []
    word = "later" if typical_s > 0 else "earlier"
    return [
        f"the ground truth moves {abs(typical_s):.2f} s {word} than the wheels (median of {len(found)} "
        "recordings), which a fit takes for wrong radii; bring both to one clock"
    ]
