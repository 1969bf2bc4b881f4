"""Whether wheels and ground truth run on the same clock, told by when both begin and end to move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.calibration.datasets import Recording
from hil.calibration.nominal import lever_m
from hil.calibration.sampling import interpolate, truth_window
from hil.robot.kinematics import WheelGeometry

_GRID_S, _WINDOW_S = 0.02, 0.2
_ALIKE = 0.9
_WORTH_S = 0.05


def time_offset_s(recording: Recording) -> float | None:
    """How much later the ground truth moves than the wheels, s; None where their speeds are not alike.

    It is where the speeds overlap most. Motion at both ends of a recording makes it smaller than it is.
    """
    at_s, pose = truth_window(recording)
    grid_s = np.arange(at_s[0], at_s[-1], _GRID_S)
    n = round(_WINDOW_S / _GRID_S)
    moved, rolled = (
        values[n:] - values[:-n]
        for values in (
            interpolate(grid_s, at_s, pose),
            interpolate(grid_s, recording.t_s, recording.wheel_angle_rad),
        )
    )
    lever = lever_m(WheelGeometry.nominal())
    truth = np.hypot(moved[:, 0], moved[:, 1]) + lever * np.abs(moved[:, 2])
    wheels = np.abs(rolled).mean(axis=1)
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


def different_clocks(recordings: Sequence[Recording]) -> list[str]:
    """One line where ground truth and wheels are typically a twentieth of a second apart, or more."""
    found = [offset_s for one in recordings if (offset_s := time_offset_s(one)) is not None]
    typical_s = float(np.median(found)) if found else 0.0
    if abs(typical_s) < _WORTH_S:
        return []
    word = "later" if typical_s > 0 else "earlier"
    return [
        f"the ground truth moves {abs(typical_s):.2f} s {word} than the wheels (median of {len(found)} "
        "recordings), which a fit takes for wrong radii; bring both to one clock"
    ]
