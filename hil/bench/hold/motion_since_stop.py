"""Measures whether a stopped robot rests, and how far it has moved since its stop."""

import math
from collections import deque
from collections.abc import Collection, Mapping

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.device import DeviceKind
from hil.core.geometry import Array

WINDOW_NS = nanoseconds(0.2)
"""Required time at rest; longer where a sensor's noise could pass for a motion."""
_LONGEST_NS, _LONGER_NS = nanoseconds(1.0), nanoseconds(0.1)
_NOISE_TIMES = 4.0
"""Required ratio of the motion threshold to the noise of a change."""
FEWEST_FOR_NOISE = 12
_SIGMA_OF_MEDIAN = 1.4826
"""Ratio of the standard deviation of Gaussian noise to the median of its magnitude."""
JOINTS = "servos"
"""The kind that measures joint angles, not a position."""
_LEAST = 4
_FRESH_NS = nanoseconds(0.05)
_FINE_M = 0.001
"""A sensor with less noise than this at rest counts any displacement; a coarser one only beyond its noise."""
_OUTVOTED_M = 0.005
"""Difference to position sensors, which agree with each other, from which the wheels do not count."""
_MEAN_OF = 5
"""Samples that are averaged against a camera's noise: 25 ms."""


class Trail:
    """Motion values of one device within the latest time window.

    Args:
        threshold: largest apparent change within `WINDOW_NS` while the robot rests. A longer window allows
            the same speed.
        fewest: number of samples in a window; with fewer the noise of the device is not known.

    Attributes:
        window_ns: present length of the window. It grows until it holds enough samples, and the device's
            noise in it is small compared with a motion.
    """

    def __init__(self, threshold: float, fewest: int = FEWEST_FOR_NOISE) -> None:
        self.window_ns = WINDOW_NS
        self._threshold, self._fewest = threshold, fewest
        self._seen: deque[tuple[int, Array]] = deque()

    def add(self, t_ns: int, place: Array) -> None:
        """Add a sample (k,): a position in m or angles in rad."""
        self._seen.append((t_ns, place))

    def forget(self, before_ns: int) -> None:
        """Drop older samples except the last one before `before_ns`, so that the window stays full."""
        while len(self._seen) > 1 and self._seen[1][0] <= before_ns:
            self._seen.popleft()

    def full(self, now_ns: int) -> bool:
        """Whether enough samples cover a whole window and are recent; lengthens the window otherwise."""
        if self._is_fresh(now_ns) and len(self._seen) < _LEAST and self._spans(now_ns):
            self.window_ns = min(self.window_ns + _LONGER_NS, _LONGEST_NS)
        if not self._reaches_back(now_ns):
            return False
        sigma = self._sigma()
        while self.window_ns < _LONGEST_NS and (
            self._expected() < self._fewest or _NOISE_TIMES * self._noise(sigma) > self._most()
        ):
            self.window_ns += _LONGER_NS
        return self._reaches_back(now_ns)

    def fills(self, now_ns: int) -> bool:
        """Whether samples arrive, but do not cover the window yet."""
        return self._is_fresh(now_ns) and not self.full(now_ns)

    def moves(self) -> bool:
        """Whether the value has changed by more than that of a robot at rest may.

        The means of the first and the last quarter are compared. With three or more samples in a quarter the
        smallest and the largest do not count: they may be corrupted.
        """
        places = np.array([place for _, place in self._seen])
        quarter = _quarter(len(places))
        change = _trimmed_mean(places[-quarter:]) - _trimmed_mean(places[:quarter])
        return float(np.abs(change).max()) > self._most()

    def _reaches_back(self, now_ns: int) -> bool:
        return self._is_fresh(now_ns) and len(self._seen) >= _LEAST and self._spans(now_ns)

    def _spans(self, now_ns: int) -> bool:
        return self._seen[0][0] <= now_ns - self.window_ns

    def _is_fresh(self, now_ns: int) -> bool:
        return bool(self._seen) and self._seen[-1][0] >= now_ns - WINDOW_NS // 2

    def _most(self) -> float:
        return self._threshold * self.window_ns / WINDOW_NS

    def _sigma(self) -> float:
        """Standard deviation of one sample; 0 for too few samples.

        It is computed from second differences, which a steady motion does not change.
        """
        if len(self._seen) < FEWEST_FOR_NOISE:
            return 0.0
        places = np.array([place for _, place in self._seen])
        rough = float(np.median(np.abs(np.diff(places, n=2, axis=0))))
        return _SIGMA_OF_MEDIAN / math.sqrt(6.0) * rough

    def _noise(self, sigma: float) -> float:
        """Standard deviation of the change in a full window that is due to noise alone."""
        return sigma * math.sqrt(2.0 / max(1, _quarter(int(self._expected())) - 1))

    def _expected(self) -> float:
        """Number of samples in a full window."""
        seen = self._seen
        return len(seen) * self.window_ns / max(seen[-1][0] - seen[0][0], 1)


class MotionSinceStop:
    """Displacement of the robot since it was stopped, by each position sensor and by its wheels.

    Args:
        kinds: kinds that detect motion, by name.
        radius_m: wheel radius, to convert wheel angles to a distance.
    """

    def __init__(self, kinds: Mapping[str, DeviceKind], radius_m: float) -> None:
        self._radius_m = radius_m
        self._coarse_m = {
            name: kind.motion_threshold
            for name, kind in kinds.items()
            if kind.measures_position and kind.motion_threshold > _FINE_M
        }
        self._latest: dict[str, deque[tuple[int, Array]]] = {
            name: deque(maxlen=_MEAN_OF)
            for name, kind in kinds.items()
            if kind.measures_position or name == JOINTS
        }
        self._was_stopped = False
        self._from: dict[str, Array] = {}
        self._farthest_m: dict[str, float] = {}

    @property
    def names(self) -> Collection[str]:
        """Names of the kinds that measure a position or joint angles."""
        return self._latest.keys()

    def passed(self, name: str, t_ns: int, place: Array) -> None:
        """Process a position (k,) in m, or joint angles (8,) in rad, of the robot while it was driven."""
        self._latest[name].append((t_ns, place))

    def stopped(self, now_ns: int) -> None:
        """Begin to measure displacements after a stop, for the sensors with a recent sample."""
        fresh_ns = now_ns - _FRESH_NS
        latest = self._latest.items()
        self._from = {name: _mean(seen) for name, seen in latest if seen and seen[-1][0] >= fresh_ns}
        for seen in self._latest.values():
            seen.clear()
        self._farthest_m.clear()
        self._was_stopped = True

    def begins_anew(self, name: str) -> None:
        """Discard the positions of a sensor whose frame has changed."""
        self._latest[name].clear()
        self._from.pop(name, None)
        self._farthest_m.pop(name, None)

    def saw(self, name: str, t_ns: int, place: Array) -> None:
        """Process a position (k,) in m, or joint angles (8,) in rad, of the robot after its stop.

        Without a stop, the displacement counts from the first sample on. A sensor without a sample at the
        stop gives no displacement.
        """
        self._latest[name].append((t_ns, place))
        here = _mean(self._latest[name])
        if not self._was_stopped:
            self._from.setdefault(name, here)
        if name not in self._from:
            return
        moved = here - self._from[name]
        if name == JOINTS:
            moved_m = self._radius_m * float(np.median(np.abs(moved[:4])))
        else:
            moved_m = float(np.linalg.norm(moved))
        self._farthest_m[name] = max(self._farthest_m.get(name, 0.0), moved_m)

    def outvoted_m(self, believed: Collection[str]) -> float:
        """Displacement by the wheels where two position sensors agree on much less, m; else 0.

        The wheels slip, or the servos' data are old: then the wheels seem to turn after the stop.

        Args:
            believed: names of the trusted sensors.
        """
        found = {name: far_m for name, far_m in self._farthest_m.items() if name in believed}
        wheels_m = found.pop(JOINTS, 0.0)
        most_m, least_m = max(found.values(), default=0.0), min(found.values(), default=0.0)
        sure = len(found) > 1 and most_m - least_m < _OUTVOTED_M < wheels_m - most_m
        return wheels_m if sure else 0.0

    def moved_m(self, believed: Collection[str], *, slides: bool) -> float | None:
        """Farthest displacement by any sensor, m; None where that is unknown, or within the noise.

        Args:
            believed: names of the trusted sensors.
            slides: True if the robot may slide, so that the wheels alone do not count.
        """
        reported = {
            name: moved_m
            for name, moved_m in self._farthest_m.items()
            if name in believed and moved_m > self._coarse_m.get(name, -math.inf)
        }
        if slides and not reported.keys() - {JOINTS}:
            return None
        if self.outvoted_m(believed):
            del reported[JOINTS]
        return max(reported.values(), default=None)


def _quarter(among: int) -> int:
    return max(1, among // 4)


def _trimmed_mean(places: Array) -> Array:
    """Mean (k,) of samples (n, k); from three samples on without the smallest and largest of each column."""
    kept = np.sort(places, axis=0)[1:-1] if len(places) > 2 else places
    mean: Array = kept.mean(axis=0)
    return mean


def _mean(seen: deque[tuple[int, Array]]) -> Array:
    total: Array = np.add.reduce([place for _, place in seen])
    return total / len(seen)
