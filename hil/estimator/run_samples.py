"""Samples of one run of the loop as arrays: of each sensor, and how fast the wheels say the robot was."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import Measurements
from hil.robot.kinematics import WheelGeometry

REST_M_S, MOVING_M_S = 1e-3, 5e-3
"""Slower than this the robot rests, faster it drives; between them it starts or stops."""
_HOLE_S = 0.05
_BEST_QUALITY = 3


class RunSamples:
    """Samples of one run as arrays, times in s since its first cycle."""

    def __init__(self, cycles: Sequence[Measurements], geometry: WheelGeometry) -> None:
        self._zero_ns = cycles[0].t_ns if cycles else 0
        self.gyro = self._rows(
            (s.stamp.t_ns, s.yaw_rate_rad_s) for m in cycles for s in m.gyro if np.isfinite(s.yaw_rate_rad_s)
        )
        self.camera, self.truth = (
            self._rows(
                (s.stamp.t_ns, *s.pose)
                for m in cycles
                for s in getattr(m, name)
                if s.valid and s.quality >= least and np.isfinite(s.pose).all()
            )
            for name, least in (("tracker", _BEST_QUALITY), ("mocap", 0))
        )
        self.wheels = self._rows(
            (s.stamp.t_ns, *s.wheel_angle_rad, *s.steering_rad)
            for m in cycles
            for s in m.wheels
            if all(s.valid)
        )
        self.steps = steps(self.wheels, geometry)

    def _rows(self, samples: Iterator[tuple[float, ...]]) -> Array:
        """(n, k) by rising time; the first column is in s."""
        rows = [(1e-9 * (t_ns - self._zero_ns), *values) for t_ns, *values in samples]
        if not rows:
            return np.zeros((0, 9))
        table = np.array(rows, dtype=np.float64)
        return table[np.unique(table[:, 0], return_index=True)[1]]

    def rests(self, begin_s: float, end_s: float) -> bool | None:
        """Whether the robot rested in all of a stretch; None where it started or stopped, or is unknown."""
        inside = self.steps[(self.steps[:, 0] >= begin_s) & (self.steps[:, 0] <= end_s)]
        if len(inside) < 2:
            return None
        slow, *_, fast = sorted(speed(half) for half in np.array_split(inside, 2))
        if fast < REST_M_S:
            return True
        return False if slow > MOVING_M_S else None

    def true_poses(self, t_s: Array) -> Array:
        """(n, 3) by motion capture; NaN where it saw nothing near."""
        if len(self.truth) < 2:
            return np.full((len(t_s), 3), np.nan)
        at_s = self.truth[:, 0]
        after = np.clip(np.searchsorted(at_s, t_s), 1, len(at_s) - 1)
        near = (at_s[after] - at_s[after - 1] < _HOLE_S) & (t_s >= at_s[0]) & (t_s <= at_s[-1])
        poses = np.column_stack([np.interp(t_s, at_s, self.truth[:, k]) for k in (1, 2, 3)])
        return np.where(near[:, None], poses, np.nan)


def steps(wheels: Array, geometry: WheelGeometry) -> Array:
    """Displacements between servo reads, (n, 11): time s, duration s, a wheel's mean way m, (8,) wheels m."""
    if len(wheels) < 2:
        return np.zeros((0, 11))
    dt = np.diff(wheels[:, 0])
    length = np.diff(wheels[:, 1:5], axis=0) * geometry.radius_m
    heading = 0.5 * (wheels[1:, 5:9] + wheels[:-1, 5:9]) - geometry.steering_zero_rad
    u = np.stack([length * np.cos(heading), length * np.sin(heading)], axis=-1).reshape(-1, 8)
    return np.column_stack([wheels[1:, 0], dt, np.abs(length).mean(axis=1), u])


def speed(steps: Array) -> float:
    """Of the body by its wheels over steps (n, 11), m/s: their noise adds up to little, unlike its size."""
    way = steps[:, 3:11].sum(axis=0).reshape(4, 2)
    return float(np.hypot(way[:, 0], way[:, 1]).max() / steps[:, 1].sum())
