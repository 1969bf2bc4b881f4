"""Where a recording starts: the ground truth averaged over its initial rest, or fitted where there is none.

One noisy first heading would cost millimetres per metre, and so would a mean over rows of motion. Where the
wheels roll from the first row on, or too few rows saw the rest, the ground truth of the first way is brought
back to the first instant along the wheels. What grows with the way, as wrong radii make it, is left out by a
straight line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array
from hil.datasets.dataset import Recording
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate, truth_window, wheel_edges, wheel_steps
from hil.robot.kinematics import twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate, sample_path

_REST_RAD = 0.02
_REST_MIN = 5
_MARGIN_S = 0.05
_BRIEF_S = 0.1
_FITTED_M, _FITTED_ROWS = 0.3, 8


@dataclass(frozen=True)
class Start:
    """Where odometry of a recording starts, at the first row of ground truth within the wheel log.

    Attributes:
        pose: (3,) m, m, rad.
        rolling: the wheels roll from there on: the pose is fitted.
    """

    pose: Array
    rolling: bool

    def doubt(self, name: str) -> list[str]:
        """One line where the robot did not rest, with the recording's name; else none."""
        if not self.rolling:
            return []
        return [
            f"{name}: the wheels roll when it begins, so its start is no rest: it is fitted to the ground "
            f"truth of the first {_FITTED_M:g} m; let the robot rest for a second first"
        ]


def start_of(recording: Recording) -> Start:
    """Where a recording starts, found once."""
    if "start" not in recording.derived:
        recording.derived["start"] = _found(recording)
    return cast("Start", recording.derived["start"])


def _found(recording: Recording) -> Start:
    at_s, truth = truth_window(recording)
    behind = recording.t_s > at_s[0]
    first = interpolate(at_s[:1], recording.t_s, recording.wheel_angle_rad)
    moved = np.max(np.abs(recording.wheel_angle_rad[behind] - first), axis=1)
    started = np.flatnonzero(moved > _REST_RAD)
    begins_s = recording.t_s[behind][started[0]] if len(started) else recording.t_s[-1]
    still = at_s < begins_s - _MARGIN_S
    if np.count_nonzero(still) >= _REST_MIN:
        return Start(np.asarray(truth[still].mean(axis=0), dtype=np.float64), rolling=False)
    return Start(_fitted(recording, at_s, truth), rolling=bool(begins_s - at_s[0] < _BRIEF_S))


def _fitted(recording: Recording, at_s: Array, truth: Array) -> Array:
    """The pose (3,) at the first of the rows, by those of the first way: stamps (n,) and poses (n, 3)."""
    wheels = recording.nominal.geometry
    edges_s = wheel_edges(recording, at_s[0], at_s[-1])
    rotation, steering = wheel_steps(recording, edges_s, "position")
    vectors = wheel_vectors(rotation * wheels.radius_m, steering - wheels.steering_zero_rad)
    motion = twist_of_vectors(wheels, vectors, "exact")
    moved = sample_path(at_s, edges_s, integrate(np.zeros(3), motion), motion)
    size = np.hypot(motion[:, 0], motion[:, 1]) + lever_m(wheels) * np.abs(motion[:, 2])
    way_m = np.interp(at_s, edges_s, np.concatenate([[0.0], np.cumsum(size)]))
    count = max(int(np.searchsorted(way_m, _FITTED_M, side="right")), min(_FITTED_ROWS, len(at_s)))
    line = np.column_stack([np.ones(count), way_m[:count]])
    heading = _at_first(line, truth[:count, 2] - moved[:count, 2])
    c, s = np.cos(heading), np.sin(heading)
    back = moved[:count, :2] @ np.array([[c, s], [-s, c]])
    return np.array([*(_at_first(line, truth[:count, k] - back[:, k]) for k in range(2)), heading])


def _at_first(line: Array, values: Array) -> float:
    """Where a straight line (n, 2) through values (n,) begins."""
    return float(np.linalg.lstsq(line, values, rcond=None)[0][0])
