"""Detects jumps of a sensor's reference frame (body redefined, camera relocalised); they are not motion.

Motion capture whose rigid body was redefined, and a camera that corrects its map, report another position
from one sample to the next. Positions before and after must not be subtracted.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from operator import sub

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array

Place = list[float]
"""Position in m; plain floats cost less per cycle than arrays of three."""

_SLACK_M, _PULL_M_S2 = 0.008, 5.0
"""Largest difference between two steps: noise (m), and half the acceleration of gravity of a falling one."""
_GAP_NS, _TOGETHER_NS = NS_PER_S // 20, NS_PER_S // 4
"""After a longer gap the position is unknown, unless the estimate covers the gap, or another sensor with
samples close to the beginning and the end of the gap shows the robot at rest.
"""
_ESTIMATED = 0.1
"""Largest error of the estimate in a gap, as a share of the distance."""
_KEPT = 64


class _Track:
    """The recent positions of one sensor.

    Attributes:
        seen: its newest positions.
        step, step_s: the latest step that was not a jump, and its duration.
        estimated: (2,) m, estimated position at the time of the newest position; None without an estimate.
    """

    def __init__(self, t_ns: int, place: Place, estimated: Array | None) -> None:
        self.seen: deque[tuple[int, Place]] = deque([(t_ns, place)], maxlen=_KEPT)
        self.step, self.step_s = [0.0] * len(place), 1.0
        self.estimated = estimated


@dataclass(frozen=True)
class _Gap:
    """`way`: displacement across the gap; `seen`: positions by other sensors at its beginning."""

    ended_ns: int
    way: Place
    seen: dict[str, Place]


class FrameJumps:
    """Follows the positions of all position sensors.

    Attributes:
        off_m: total displacement of a sensor's frame, by kind.
    """

    def __init__(self) -> None:
        self._tracks: dict[str, _Track] = {}
        self._gaps: dict[str, _Gap] = {}
        self.off_m: dict[str, Place] = {}

    def size_m(self, name: str) -> float:
        """Distance by which the frame of a sensor has moved, m."""
        return math.hypot(*self.off_m.get(name, (0.0,)))

    def run_ended(self) -> None:
        """Discard the estimates: the next run may begin at any estimate."""
        for track in self._tracks.values():
            track.estimated = None

    def begins_anew(self, name: str) -> None:
        """Forget a sensor that has reported a restart: its earlier positions do not count."""
        self._tracks.pop(name, None)
        self._gaps.pop(name, None)

    def follow(self, name: str, t_ns: int, place: Array, estimated: Array | None = None) -> tuple[str, ...]:
        """Process a sample; return the kinds whose frame has moved.

        Args:
            name: name of its kind.
            t_ns: time of the sample.
            place: (k,) position, m.
            estimated: (2,) position by the estimate in the loop, m, if there is one.
        """
        here: Place = place.tolist()
        track = self._tracks.get(name)
        if track is None:
            self._tracks[name] = _Track(t_ns, here, estimated)
            return tuple(self._behind_gaps(t_ns))
        before_ns, before = track.seen[-1]
        if t_ns <= before_ns:
            return ()
        was = track.estimated
        if estimated is not None:
            track.estimated = estimated
        step, jump = list(map(sub, here, before)), None
        if t_ns - before_ns <= _GAP_NS:
            jump = self._step(track, step, (t_ns - before_ns) / NS_PER_S)
        else:
            track.step, track.step_s = [0.0] * len(here), 1.0
            if was is not None and estimated is not None:
                jump = _beyond(step, math.dist(estimated, was))
            else:
                self._gaps[name] = _Gap(t_ns, step, dict(self._others(name, before_ns)))
        track.seen.append((t_ns, here))
        if jump is None and not self._gaps:
            return ()
        moved = [] if jump is None else [self._moved(name, jump)]
        return (*moved, *self._behind_gaps(t_ns))

    def _step(self, track: _Track, step: Place, dt_s: float) -> Place | None:
        """The difference from the previous step if it is a jump; else None."""
        before_s = track.step_s
        as_before = [a / before_s * dt_s for a in track.step]
        if math.dist(step, as_before) > _SLACK_M + _PULL_M_S2 * dt_s**2:
            return list(map(sub, step, as_before))
        track.step, track.step_s = step, dt_s
        return None

    def _others(self, name: str, at_ns: int) -> Iterator[tuple[str, Place]]:
        """Positions of the robot by other sensors at about that time."""
        for other, track in self._tracks.items():
            if other == name:
                continue
            t_ns, place = min(track.seen, key=lambda one: abs(one[0] - at_ns))
            if abs(t_ns - at_ns) <= _TOGETHER_NS:
                yield other, place

    def _behind_gaps(self, now_ns: int) -> Iterator[str]:
        """Sensors whose position moved in a gap while another sensor showed the robot at rest."""
        for name, gap in list(self._gaps.items()):
            for other, place in self._others(name, gap.ended_ns):
                if other in gap.seen and math.dist(place, gap.seen[other]) <= _SLACK_M < math.hypot(*gap.way):
                    yield self._moved(name, gap.way)
                    break
            if now_ns - gap.ended_ns > _TOGETHER_NS:
                self._gaps.pop(name, None)

    def _moved(self, name: str, way: Place) -> str:
        self._gaps.pop(name, None)
        self.off_m[name] = [a + b for a, b in zip(self.off_m.get(name, [0.0] * len(way)), way, strict=True)]
        return name


def _beyond(step: Place, way_m: float) -> Place | None:
    """The part of a step beyond a displacement of that length; None within tolerance."""
    length_m = math.hypot(*step)
    further_m = length_m - way_m
    if abs(further_m) <= _SLACK_M + _ESTIMATED * way_m:
        return None
    return [a * (further_m / max(length_m, _SLACK_M)) for a in step]
