"""Measures whether a stopped robot rests, and how far it has moved since its stop."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.device import DeviceKind
from hil.core.geometry import Array

WINDOW_NS = nanoseconds(0.2)
"""For so long a robot has to rest; longer where a sensor's noise would pass for a motion."""
_LONGEST_NS, _LONGER_NS = nanoseconds(1.0), nanoseconds(0.1)
_NOISE_TIMES = 4.0
"""A change that noise leads to has to be so much smaller than a motion."""
_FEWEST_FOR_NOISE = 12
_SIGMA_OF_MEDIAN = 1.4826
"""Standard deviation of normal noise by the median of its size."""
JOINTS = "servos"
"""The kind that measures angles of joints, and no position."""
_LEAST = 4
_FRESH_NS = nanoseconds(0.05)
_FINE_M = 0.001
"""A sensor with less noise than this at rest counts any displacement; a coarser one only beyond its noise."""
_MEAN_OF = 5
"""Sightings that are averaged against a camera's noise: 25 ms of it."""


class Trail:
    """Where one device has seen the robot within the latest window.

    Args:
        threshold: by how much the place may seem to change within `WINDOW_NS` while the robot rests. A longer
            window allows the same speed.

    Attributes:
        window_ns: how long the window is by now. It grows until the noise that the device has in it is small
            beside a motion.
    """

    def __init__(self, threshold: float) -> None:
        self.window_ns = WINDOW_NS
        self._threshold = threshold
        self._seen: deque[tuple[int, Array]] = deque()

    def add(self, t_ns: int, place: Array) -> None:
        """Take a sighting: (k,), of a place in m or of angles in rad."""
        self._seen.append((t_ns, place))

    def forget(self, before_ns: int) -> None:
        """Drop what is older, but for the last of it: the window is to be full."""
        while len(self._seen) > 1 and self._seen[1][0] <= before_ns:
            self._seen.popleft()

    def full(self, now_ns: int) -> bool:
        """Whether it reaches back for a window, and is not out of date."""
        if not self._reaches_back(now_ns):
            return False
        sigma = self._sigma()
        while self.window_ns < _LONGEST_NS and _NOISE_TIMES * self._noise(sigma) > self._most():
            self.window_ns += _LONGER_NS
        return self._reaches_back(now_ns)

    def fills(self, now_ns: int) -> bool:
        """Whether it is on its way to be full."""
        return self._is_fresh(now_ns) and not self.full(now_ns)

    def moves(self) -> bool:
        """Whether the place has changed by more than that of a robot at rest may.

        The means of the first and the last quarter are compared. Of three and more sightings in one the least
        and the greatest do not count: they may have been garbled on the way.
        """
        places = np.array([place for _, place in self._seen])
        quarter = _quarter(len(places))
        change = _trimmed_mean(places[-quarter:]) - _trimmed_mean(places[:quarter])
        return float(np.abs(change).max()) > self._most()

    def _reaches_back(self, now_ns: int) -> bool:
        seen = self._seen
        return self._is_fresh(now_ns) and len(seen) >= _LEAST and seen[0][0] <= now_ns - self.window_ns

    def _is_fresh(self, now_ns: int) -> bool:
        return bool(self._seen) and self._seen[-1][0] >= now_ns - WINDOW_NS // 2

    def _most(self) -> float:
        return self._threshold * self.window_ns / WINDOW_NS

    def _sigma(self) -> float:
        """Standard deviation of one sighting; 0 of too few.

        Second differences show it, whether or not the robot moves.
        """
        if len(self._seen) < _FEWEST_FOR_NOISE:
            return 0.0
        places = np.array([place for _, place in self._seen])
        rough = float(np.median(np.abs(np.diff(places, n=2, axis=0))))
        return _SIGMA_OF_MEDIAN / math.sqrt(6.0) * rough

    def _noise(self, sigma: float) -> float:
        """Standard deviation of the change that noise alone leads to in a full window."""
        seen = self._seen
        expected = len(seen) * self.window_ns / max(seen[-1][0] - seen[0][0], 1)
        return sigma * math.sqrt(2.0 / max(1, _quarter(int(expected)) - 1))


class MotionSinceStop:
    """How far the robot is from where it was stopped, by each sensor of position, and by its wheels.

    Args:
        kinds: those that notice a motion, by name.
        radius_m: of the wheels, to turn their angles into a way.
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
        """The sensors of a position or an angle."""
        return self._latest.keys()

    def passed(self, name: str, t_ns: int, place: Array) -> None:
        """The robot was seen there, (k,) in m, or its joints so, (8,) in rad, while it was driven."""
        self._latest[name].append((t_ns, place))

    def stopped(self, now_ns: int) -> None:
        """The robot has been stopped: its way counts from here on, by the sensor that has just seen it."""
        fresh_ns = now_ns - _FRESH_NS
        latest = self._latest.items()
        self._from = {name: _mean(seen) for name, seen in latest if seen and seen[-1][0] >= fresh_ns}
        for seen in self._latest.values():
            seen.clear()
        self._farthest_m.clear()
        self._was_stopped = True

    def begins_anew(self, name: str) -> None:
        """The sensor's frame has changed: forget its positions."""
        self._latest[name].clear()
        self._from.pop(name, None)
        self._farthest_m.pop(name, None)

    def saw(self, name: str, t_ns: int, place: Array) -> None:
        """The robot is seen there, (k,) in m or its joints (8,) in rad, after its stop.

        If nothing has stopped it, its way counts from there on.
        Who did not see where it was stopped cannot say how far it has gone.
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

    def moved_m(self, believed: Collection[str], *, slides: bool) -> float | None:
        """Farthest displacement by any sensor, m; None where that is unknown, or within the noise.

        Args:
            believed: whose word counts.
            slides: whether it may move without its wheels, so that they alone do not count.
        """
        reported = {
            name: moved_m
            for name, moved_m in self._farthest_m.items()
            if name in believed and moved_m > self._coarse_m.get(name, -math.inf)
        }
        if slides and not reported.keys() - {JOINTS}:
            return None
        return max(reported.values(), default=None)


def _quarter(among: int) -> int:
    return max(1, among // 4)


def _trimmed_mean(places: Array) -> Array:
    """Mean (k,) of places (n, k) without the least and the greatest of each column, of three or more."""
    kept = np.sort(places, axis=0)[1:-1] if len(places) > 2 else places
    mean: Array = kept.mean(axis=0)
    return mean


def _mean(seen: deque[tuple[int, Array]]) -> Array:
    total: Array = np.add.reduce([place for _, place in seen])
    return total / len(seen)
