"""Lateness of the stamps of IMU and camera, found by their motion and that of the wheels.

Turns, and for the camera ways too, over a fifth of a second are correlated at shifts of up to half a second.
A drive without changes of speed does not determine it, and says nothing.
"""

from collections.abc import Iterator

import numpy as np

from hil.core.geometry import Array
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate, wheel_steps
from hil.datasets.sensor_moves import camera_path, gyro_turns
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry, forward
from hil.robot.odometry import integrate

_GRID_S, _WINDOW, _FURTHEST = 0.01, 20, 50
"""Grid, s; window and largest shift in steps of it."""
_ALIKE, _SURE = 0.9, 20.0
"""Least correlation at the best shift; least growth of what it leaves a tenth of a second beside, summed over
windows that do not overlap, as a share of what it leaves."""
_BESIDE = 10
_LATE_S, _LEAST_S = 0.03, 3.0


def lateness_s(recording: Recording, geometry: WheelGeometry) -> dict[str, float]:
    """Lateness of each sensor's stamps against those of the wheels, s, where the drive determines it.

    Args:
        recording: recording with its sensors.
        geometry: geometry of the wheels.
    """
    lever = lever_m(geometry)
    found: dict[str, float] = {}
    for table, (t_s, path) in (("imu", gyro_turns(recording)), ("tracker", camera_path(recording))):
        if len(t_s) < 2:
            continue
        begin_s, end_s = max(recording.t_s[0], t_s[0]), min(recording.t_s[-1], t_s[-1])
        if end_s - begin_s < _LEAST_S:
            continue
        grid_s = np.arange(begin_s, end_s, _GRID_S)
        with_way = table == "tracker"
        own = _signal(interpolate(grid_s, t_s, path), lever, with_way)
        late = _shift(own, _signal(_by_wheels(recording, grid_s, geometry), lever, with_way))
        if late is not None:
            found[table] = late
    return found


def late_sensors(recording: Recording, geometry: WheelGeometry) -> Iterator[str]:
    """One line for each sensor whose stamps contradict those of the wheels, with what would agree."""
    for table, late in lateness_s(recording, geometry).items():
        if abs(late) > _LATE_S:
            yield (
                f"[{table}]: its stamps are {abs(late):.3f} s {'later' if late > 0 else 'earlier'} than its "
                f'motion by the wheels: add {late:.3f} to its latency_s, or set latency_s = "fit"'
            )


def _by_wheels(recording: Recording, grid_s: Array, geometry: WheelGeometry) -> Array:
    rotation, steering = wheel_steps(recording, grid_s, "position")
    return integrate(np.zeros(3), forward(geometry, rotation * geometry.radius_m, steering))


def _signal(path: Array, lever: float, with_way: bool) -> Array:
    """Turns (n, 1), and ways (n, 2), over the windows of a path (n + window, 3), m."""
    moved = path[_WINDOW:] - path[:-_WINDOW]
    turns = lever * moved[:, 2:]
    return np.hstack([turns, np.hypot(moved[:, :1], moved[:, 1:2])]) if with_way else turns


def _shift(own: Array, wheels: Array) -> float | None:
    """Time by which the sensor's signal (n, k) is later, s; None where it is not determined."""
    shifts = range(-_FURTHEST, _FURTHEST + 1)
    inner = wheels[_FURTHEST:-_FURTHEST]
    alike = np.array([_alike(own[_FURTHEST + k : len(own) - _FURTHEST + k], inner) for k in shifts])
    best = int(np.argmax(alike))
    if not _BESIDE <= best < len(alike) - _BESIDE or alike[best] < _ALIKE:
        return None
    beside = max(alike[best - _BESIDE], alike[best + _BESIDE])
    sharper = (1.0 - beside) / max(1.0 - alike[best], 1e-9) - 1.0
    if sharper * len(inner) / _WINDOW < _SURE:
        return None
    before, at, behind = alike[best - 1 : best + 2]
    return float((shifts[best] + 0.5 * (before - behind) / (before - 2.0 * at + behind)) * _GRID_S)


def _alike(one: Array, other: Array) -> float:
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    return float(np.sum(a * b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12))
