"""Compares motion capture with camera and wheels, and finds which of the three disagrees with the others.

Motion capture has no scale error and no slip, so a camera may differ from it only by its scale, and wheels
only by creep. It stays independent: its poses enter no estimate here. Deterministic: depends only on the
measurements since `reset`.
"""

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass

from hil.core.clock import NS_PER_S
from hil.core.signals import PoseMeasurement
from hil.loop.checks.cusum import CAMERA, STEP_NS, WHEELS, MotionSource, Relocalisation, Sum
from hil.loop.checks.dead_reckoning import Kept, Track, WheelTrack, moved, rolled

CAPTURE = MotionSource("mocap", "motion capture")
GAP_NS = 300_000_000
_TURNED_RAD, _ALIKE = 0.02, 0.3
"""Turn from which motion capture can bear out the wheels, and share of it by which they may differ."""


@dataclass(frozen=True)
class MocapTolerances:
    """Permitted differences of camera and wheels from motion capture.

    Attributes:
        scale: m per metre along the path: the camera's scale, 1 to 2 % where it has not been measured.
        across: m per metre across the path: rotation of the rigid body's axes against the robot's.
        lever_m: m per radian turned: offset of the rigid body's origin.
        rest_m_s: drift of a camera while nothing moves.
        warn_m, stop_m: sums for a warning and for a stop: an undetected camera delay of 50 ms gives 6 mm
            after every start and stop at 0.12 m/s.
        path: m per rolled metre by which wheels differ: radii (1 %), wheels that are not parallel (3 %).
        slipped_warn_m, slipped_stop_m: sums as `warn_m` and `stop_m`, for the wheels.
    """

    scale: float = 0.03
    across: float = 0.05
    lever_m: float = 0.05
    rest_m_s: float = 0.001
    warn_m: float = 0.007
    stop_m: float = 0.01
    path: float = 0.04
    slipped_warn_m: float = 0.006
    slipped_stop_m: float = 0.009


class PoseTrack(Track):
    """Time series of position (m, complex) and heading (rad); an invalid pose or a gap restarts it."""

    def take(self, poses: Iterable[PoseMeasurement]) -> None:
        """Add measured poses."""
        for pose in poses:
            t_ns, last_ns = pose.stamp.t_ns, self.newest_ns
            x_m, y_m, heading_rad = pose.pose.tolist()
            if not (pose.valid and math.isfinite(x_m + y_m + heading_rad)):
                self.clear()
            elif last_ns is None or t_ns > last_ns:
                if last_ns is not None and t_ns - last_ns > GAP_NS:
                    self.clear()
                self.put(t_ns, (complex(x_m, y_m), heading_rad))


class MocapAgreement:
    """Sums of the differences between motion capture and camera, and between motion capture and wheels.

    Args:
        wheels: track of the wheels, updated by another check.
        seen: permitted differences.
        creep: m per rolled metre by which a robot on a wall creeps down.

    Attributes:
        camera, rolled: the two sums.
        ways_m: distances over which camera and wheels have been compared since `reset`.
        allowed: permitted differences.
        camera_track, track: recent poses of camera and motion capture.
    """

    def __init__(self, wheels: WheelTrack, seen: MocapTolerances, *, creep: float) -> None:
        self._wheels, self.allowed, self._creep = wheels, seen, creep
        self.camera = Sum(CAMERA, CAPTURE, seen.warn_m, seen.stop_m)
        self.rolled = Sum(CAPTURE, WHEELS, seen.slipped_warn_m, seen.slipped_stop_m)
        self.camera_track, self.track = PoseTrack(), PoseTrack()
        self._leaps = (Relocalisation(), Relocalisation())
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        for part in (self.camera, self.rolled, self.camera_track, self.track, *self._leaps):
            part.reset()
        self._last: list[tuple[int, Kept, Kept] | None] = [None, None]
        self.ways_m = [0.0, 0.0]
        self._ways, self._errors, self._crept = [0j, 0j], [0j, 0j], 0j
        self._turned_rad = self._turned_off_rad = 0.0

    def take(self, camera: tuple[PoseMeasurement, ...], capture: tuple[PoseMeasurement, ...]) -> None:
        """Add the poses of one cycle."""
        self.camera_track.take(camera)
        self.track.take(capture)

    def compare(self) -> bool:
        """Add a step of each pair, if enough time has passed; return whether a step was added."""
        camera, wheels = self._step(0, self.camera_track), self._step(1, self._wheels)
        if camera is not None:
            self._add_camera(*camera)
        if wheels is not None:
            self._add_wheels(*wheels)
        return not (camera is None and wheels is None)

    @property
    def turns_with_wheels(self) -> bool:
        """Whether the robot has turned clearly since `reset`, and the wheels turned with motion capture."""
        return abs(self._turned_rad) > max(_TURNED_RAD, abs(self._turned_off_rad) / _ALIKE)

    def unseen(self, pair: Sum) -> bool:
        """Whether a pair includes wheels that may have slipped before the camera delivered poses."""
        return pair is self.rolled and not self.camera_track.covers(pair.since_ns)

    def ways(self) -> tuple[complex, complex]:
        """Displacements of camera and wheels since `reset` while captured (m, motion capture's axes)."""
        camera, wheels = self._ways
        return camera, wheels

    def errors(self) -> tuple[complex, complex]:
        """Differences of `ways` from motion capture (m); for wheels without the permitted creep."""
        camera, wheels = self._errors
        most = abs(self._crept)
        if not most:
            return camera, wheels
        up = self._crept / most
        crept = min(max((wheels / up).real, 0.0), most)
        return camera, wheels - crept * up

    def _go(self, pair: int, heading: complex, way: complex, true: complex) -> None:
        """Add a step in body axes to the displacements, rotated by the heading of motion capture."""
        axes = cmath.rect(1.0, heading.real)
        self._ways[pair] += way * axes
        self._errors[pair] += (way - true) * axes

    def _step(self, pair: int, other: Track) -> tuple[int, float, Kept, Kept, Kept, Kept] | None:
        """A step: beginning, duration (s), and values before and after, of another track and of capture."""
        newest, others = self.track.newest_ns, other.newest_ns
        if newest is None or others is None:
            self._last[pair] = None
            return None
        t_ns, before = min(newest, others), self._last[pair]
        if before is not None and 0 <= t_ns - before[0] < STEP_NS:
            return None
        now, seen = other.at(t_ns), self.track.at(t_ns)
        if now is None or seen is None:
            return None
        self._last[pair] = (t_ns, now, seen)
        if before is None or not 0 < t_ns - before[0] < GAP_NS:
            return None
        began_ns = before[0]
        if not (self.track.covers(began_ns) and other.covers(began_ns)):
            return None
        return began_ns, (t_ns - began_ns) / NS_PER_S, before[1], now, before[2], seen

    def _add_camera(self, t_ns: int, dt_s: float, before: Kept, now: Kept, was: Kept, seen: Kept) -> None:
        h = self.allowed
        way, turn = moved(before, now)
        true, turned = moved(was, seen)
        if self._leaps[0].jumped(t_ns, abs(way - true), abs(turn - turned)):
            return
        self.ways_m[0] += abs(true)
        self._go(0, was[1], way, true)
        allowed = h.lever_m * abs(turned) + h.rest_m_s * dt_s
        self.camera.add(t_ns, way, true, allowed, cmath.rect(1.0, -turned), way=(h.scale, h.across))

    def _add_wheels(self, t_ns: int, dt_s: float, before: Kept, now: Kept, was: Kept, seen: Kept) -> None:
        h = self.allowed
        true, turned = moved(was, seen)
        rolling, turning = moved(before, now)
        far, loose = rolled(before, now)
        if self._leaps[1].jumped(t_ns, abs(true - rolling), abs(turned - turning)):
            return
        self.ways_m[1] += far
        self._turned_rad += turned
        self._turned_off_rad += turned - turning
        self._go(1, was[1], rolling, true)
        self._crept += self._creep * far * cmath.rect(1.0, was[1].real)
        allowed = h.path * far + h.lever_m * abs(turning) + h.rest_m_s * dt_s + loose
        self.rolled.add(t_ns, true, rolling, allowed, cmath.rect(1.0, -turning), self._creep * far)
