"""Start pose of a recording: ground truth averaged over the initial rest, or fitted where there is none.

A single noisy heading at the start would cost millimetres per metre, and so would a mean over moving rows.
Where the wheels roll from the first row on, or the rest has too few rows, the ground truth of the first part
of the way is transformed back to the first instant by odometry. A straight line over the distance removes
errors that grow with it, as from wrong radii.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate, truth_window, wheel_edges, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import forward
from hil.robot.odometry import integrate, sample_path

_REST_RAD = 0.02
_REST_MIN = 5
_MARGIN_S = 0.05
_BRIEF_S = 0.1
_FITTED_M, _FITTED_ROWS = 0.3, 8


@dataclass(frozen=True)
class Start:
    """Start pose of odometry, at the first row of ground truth within the wheel log.

    Attributes:
        pose: (3,) m, m, rad.
        rolling: True if the wheels roll from there on, so that the pose is fitted.
    """

    pose: Array
    rolling: bool

    def doubt(self, name: str) -> list[str]:
        """One line with the recording's name where the robot did not rest; else none."""
        if not self.rolling:
            return []
        return [
            f"{name}: the wheels roll when it begins: its start is fitted to the ground truth of the "
            f"first {_FITTED_M:g} m; let the robot rest for a second first"
        ]


def start_of(recording: Recording) -> Start:
    """Start of a recording; computed once and cached; at the origin where there is no ground truth."""
    if "start" not in recording.derived:
        recording.derived["start"] = _found(recording)
    return cast("Start", recording.derived["start"])


def _found(recording: Recording) -> Start:
    if not recording.has_truth:
        return Start(np.zeros(3), rolling=False)
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
    """Pose (3,) at the first row, fitted to the first 0.3 m of the way: stamps (n,) and poses (n, 3)."""
    wheels = recording.nominal.geometry
    edges_s = wheel_edges(recording, at_s[0], at_s[-1])
    rotation, steering = wheel_steps(recording, edges_s, "position")
    motion = forward(wheels, rotation * wheels.radius_m, steering)
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
    """Value at the start of the least-squares line (n, 2) through values (n,)."""
    return float(np.linalg.lstsq(line, values, rcond=None)[0][0])
