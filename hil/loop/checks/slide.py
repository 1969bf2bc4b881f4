"""Finds a robot that slides, by two position sensors that agree: soon enough to hold it again.

Camera and motion capture show how far the body has moved within a short time, the wheels how far they have
rolled. Where both show the same excess in the same direction, the robot slides, whatever else is measured. It
must also exceed what was commanded: wheels whose data are old roll although they seem to rest.
Slow slides are found by the sums of `hil.loop.checks.motion_agreement`. Deterministic: depends only on the
measurements since `reset`.
"""

import math
from collections.abc import Collection

from hil.core.clock import NS_PER_S
from hil.loop.checks.adhesion import AdhesionWatch
from hil.loop.checks.adhesion_limits import SlidePush
from hil.loop.checks.dead_reckoning import Kept, Track, WheelTrack, moved, rolled
from hil.loop.checks.mocap_agreement import PoseTrack
from hil.loop.cycle_data import Check, Cycle

WINDOW_NS = 80_000_000
_LEAST_M, _SHARE, _LEVER_M = 0.003, 0.1, 0.05
"""Excess within the window that is a slide: three times the noise of a camera; addition per rolled metre
and per radian turned. A camera whose delay is 50 ms off gives 2 mm where the robot starts and stops."""
_SLOW_M = 0.001
"""The same once another check has found that the robot slides: here only its direction counts."""
_OLD_NS = 60_000_000
"""Age of the wheels' data, against the poses', from which nothing is compared."""
_AGAIN_NS = 10_000_000
"""The window that ended so long before must show the slide, too."""


class Slide:
    """The excess of two position sensors over the wheels, along the body's x axis.

    Args:
        wheels: track of the wheels.
        camera: track of the camera.
        capture: track of motion capture.

    Attributes:
        excess_m: smaller excess of the two within the newest window, m; 0 where they do not agree on its
            direction, or beyond their tolerance.
        certain: True if both have shown a slide twice.
    """

    def __init__(self, wheels: WheelTrack, camera: PoseTrack, capture: PoseTrack) -> None:
        self._wheels, self._places = wheels, (camera, capture)
        self.reset()

    def reset(self) -> None:
        """Clear what was seen."""
        self._looked_ns, self.excess_m, self.certain = 0, 0.0, False

    def look(self, commanded: Track | None = None) -> None:
        """Compare the newest poses with the wheels.

        Args:
            commanded: track of the commanded way along body x, m; None for wheels that are to rest.
        """
        newest = [place.newest_ns for place in self._places if place.newest_ns is not None]
        if len(newest) < len(self._places) or min(newest) <= self._looked_ns:
            return
        self._looked_ns = t_ns = min(newest)
        self.excess_m = self._excess_m(t_ns, commanded)
        before_m = self._excess_m(t_ns - _AGAIN_NS, commanded) if abs(self.excess_m) > _LEAST_M else 0.0
        self.certain = abs(before_m) > _LEAST_M and before_m * self.excess_m > 0.0

    def _excess_m(self, t_ns: int, commanded: Track | None) -> float:
        """Smallest excess of the poses in the window that ends at `t_ns`; 0 where their signs differ."""
        wheels_ns = self._wheels.newest_ns
        if wheels_ns is None or t_ns - wheels_ns > _OLD_NS:
            return 0.0
        rolling = _window(self._wheels, min(t_ns, wheels_ns))
        seen = [window for place in self._places if (window := _window(place, t_ns)) is not None]
        asked = None if commanded is None else _window(commanded, t_ns)
        if rolling is None or len(seen) < len(self._places) or (asked is None) != (commanded is None):
            return 0.0
        (way, turn), (far_m, loose_m) = moved(*rolling), rolled(*rolling)
        tolerance_m = _SHARE * far_m + loose_m + _LEVER_M * abs(turn)
        asked_m = 0.0 if asked is None else (asked[1][0] - asked[0][0]).real
        moved_m = [moved(*window)[0].real for window in seen]
        found_m = [m - other_m for m in moved_m for other_m in (way.real, asked_m)]
        if min(found_m) < 0.0 < max(found_m):
            return 0.0
        return math.copysign(max(min(map(abs, found_m)) - tolerance_m, 0.0), found_m[0])


def _window(track: Track, end_ns: int) -> tuple[Kept, Kept] | None:
    """Values of a track at both ends of the window; None where it does not cover it."""
    before, now = track.at(end_ns - WINDOW_NS), track.at(end_ns)
    return None if before is None or now is None else (before, now)


class CommandedWay(Track):
    """Way along body x by the commanded wheel rates, m (complex).

    Args:
        radius_m: radius of the wheels.
    """

    def __init__(self, radius_m: float) -> None:
        super().__init__()
        self._radius_m = radius_m

    def reset(self) -> None:
        """Remove all values."""
        self.clear()
        self._way_m, self._ahead = 0.0, [1.0] * 4

    def take(self, cycle: Cycle) -> None:
        """Add the command of the previous cycle, with the newest steering angles."""
        t_ns = cycle.inputs.t_ns
        for wheels in cycle.measurements.wheels:
            if all(wheels.valid):
                self._ahead = [math.cos(angle) for angle in wheels.steering_rad.tolist()]
        if self.newest_ns is not None:
            rates = zip(cycle.last.wheel_rate_rad_s, self._ahead, strict=True)
            along_rad_s = sum(rate * ahead for rate, ahead in rates) / 4.0
            self._way_m += self._radius_m * along_rad_s * (t_ns - self.newest_ns) / NS_PER_S
        self.put(t_ns, (complex(self._way_m),))


class SlideCheck(Check):
    """Stops a hanging robot that slides by camera and motion capture, and works out the push against that.

    Args:
        slide: the excess that both have shown.
        radius_m: radius of the wheels.
        hold: check of the adhesion force.
        suspects: kinds of devices that may be the cause.
        advice: end of the message.

    Attributes:
        push: set-point of the propellers after the stop; None where they are left as they are.
    """

    def __init__(
        self, slide: Slide, radius_m: float, hold: AdhesionWatch, suspects: Collection[str], advice: str
    ) -> None:
        self._slide, self._hold, self._commanded = slide, hold, CommandedWay(radius_m)
        self._suspects, self._advice = (*suspects, "servos"), advice
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._slide.reset()
        self._commanded.reset()
        self.push: SlidePush | None = None

    def on_samples(self, cycle: Cycle) -> None:
        """Compare the newest poses with the wheels."""
        self._commanded.take(cycle)
        self._slide.look(self._commanded)
        along_m, found = self._slide.excess_m, "sensors_disagree" in cycle.stops
        if not (self._slide.certain or (found and abs(along_m) > _SLOW_M)):
            return
        self.push = self._hold.push_against(along_m)
        way = f"{1e3 * abs(along_m):.0f} mm {'forwards' if along_m > 0.0 else 'backwards'}"
        message = (
            f"within {WINDOW_NS / NS_PER_S:g} s the robot slid {way} by camera and motion capture, and its "
            "wheels did not roll so"
        )
        if self.push is not None:
            message += f"; the propellers are to push with {self.push.force_n:.1f} N against it"
        cycle.stop("sliding", message + self._advice, self._suspects)
