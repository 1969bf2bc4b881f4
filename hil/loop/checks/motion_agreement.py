"""Compares the motion by camera, wheels and gyro, and finds the one that disagrees.

The differences of two sensors are summed step by step. At each step the sum is reduced by the tolerance of
good sensors (`Tolerances`), never below zero: good sensors stay near zero over any distance, and a camera
that is frozen or has another scale exceeds the limit within centimetres. Deterministic: depends only on the
measurements since `reset`.
"""

import cmath
from dataclasses import dataclass, replace

from hil.core.clock import NS_PER_S
from hil.core.signals import Measurements, PoseMeasurement
from hil.loop.checks.cusum import CAMERA, STEP_NS, WHEELS, Disagreement, MotionSource, Relocalisation, Sum
from hil.loop.checks.dead_reckoning import GyroTrack, Kept, WheelTrack, moved, rolled
from hil.loop.checks.mocap_agreement import MocapAgreement, MocapTolerances
from hil.loop.checks.slide import Slide
from hil.loop.checks.wheel_radius import WheelRadiusCheck
from hil.loop.checks.wheel_slip import WheelSlipCheck
from hil.robot.kinematics import WheelGeometry

GYRO = MotionSource("imu", "the gyro")
_GAP_NS = 1_000_000_000
_AGREE_M = 0.1
"""A sensor that has agreed with others over this distance is trusted again: a frozen camera is found in a
sixth of it.
"""


@dataclass(frozen=True)
class Tolerances:
    """Permitted differences of good sensors, and limits from which one of two is wrong.

    Attributes:
        path: m per rolled metre: the camera's scale (1 to 2 %), radii (1 %), wheels that are not quite
            parallel (3 % in the robot's public recordings of lines).
        creep: m per rolled metre in addition, by which a robot on a wall creeps down: 5 to 8 % have been
            observed, both climbing and across.
        lever_m: m per radian turned: before its calibration, a camera's place on the body is known to 2 to
            3 cm.
        rest_m_s: drift of a camera while nothing moves.
        turn: rad per radian that the wheels measure: track, radii and scrubbing; 2.3 % in the robot's public
            recordings of turns in place.
        turn_rad_m: rad per rolled metre: wheels that are not parallel; 0.03 in those of lines.
        gyro, gyro_rad_s: rad per radian, and rad per second of bias: the data sheet allows 3 degrees per
            second before the chip has calibrated itself.
        camera_rad_s: drift of the camera's heading.
        warn_m, warn_rad: sums for a warning. A pose has 0.3 to 1.5 mm of noise, and an undetected camera
            delay of 50 ms gives 6 mm after every start and stop at 0.12 m/s.
        stop_m, stop_rad: sums at which the robot must stop.
    """

    path: float = 0.05
    creep: float = 0.06
    lever_m: float = 0.03
    rest_m_s: float = 0.001
    turn: float = 0.05
    turn_rad_m: float = 0.04
    gyro: float = 0.03
    gyro_rad_s: float = 0.053
    camera_rad_s: float = 0.003
    warn_m: float = 0.008
    warn_rad: float = 0.05
    stop_m: float = 0.012
    stop_rad: float = 0.08


@dataclass(frozen=True)
class _Seen:
    """Values at one instant: position and heading by the camera, and values of wheels and gyro."""

    t_ns: int
    place: complex
    heading_rad: float
    wheels: Kept
    gyro: Kept | None


class MotionCheck:
    """Compares the motion sensors of one bench.

    Args:
        geometry: wheel geometry.
        honest: permitted differences of good sensors.
        on_wall: True if body x points up, within the heading limit on a wall.
        seen: permitted differences of camera and wheels from motion capture.

    Attributes:
        capture: motion capture against camera and wheels.
        radius_m: mean radius of the wheels.
    """

    def __init__(
        self,
        geometry: WheelGeometry,
        honest: Tolerances | None = None,
        *,
        on_wall: bool = True,
        seen: MocapTolerances | None = None,
    ) -> None:
        self._on_wall, self._geometry = on_wall, geometry
        self.honest = h = honest if honest is not None else Tolerances()
        self._wheels, self._gyro = WheelTrack(geometry), GyroTrack()
        self.radius_m = float(geometry.radius_m.mean())
        self._arm_m = float((geometry.x_m**2 + geometry.y_m**2).mean() ** 0.5)
        self._way = Sum(CAMERA, WHEELS, h.warn_m, h.stop_m)
        self._camera_wheels = Sum(CAMERA, WHEELS, h.warn_rad, h.stop_rad, turns=True)
        self._camera_gyro = Sum(CAMERA, GYRO, h.warn_rad, h.stop_rad, turns=True)
        self._wheels_gyro = Sum(WHEELS, GYRO, h.warn_rad, h.stop_rad, turns=True)
        self._turns = (self._camera_wheels, self._camera_gyro, self._wheels_gyro)
        seen = seen if seen is not None else MocapTolerances()
        self.capture = MocapAgreement(self._wheels, seen, creep=h.creep if on_wall else 0.0)
        self._ways = (self._way, self.capture.camera, self.capture.rolled)
        self._sums = (*self._ways, *self._turns)
        self._leap = Relocalisation()
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._wheels.reset()
        self._gyro.reset()
        for one in (self._way, *self._turns, self._leap, self.capture):
            one.reset()
        self._seen: _Seen | None = None
        self._felt: tuple[int, Kept, Kept] | None = None
        self._left_out: set[str] = set()
        self._way_m = 0.0

    def update(self, measurements: Measurements) -> tuple[Disagreement, ...]:
        """Process one cycle's measurements; return the disagreements to report."""
        for wheels in measurements.wheels:
            self._wheels.take(wheels)
        for gyro in measurements.gyro:
            self._gyro.take(gyro)
        looked = self._look(measurements.tracker)
        if measurements.mocap:
            self.capture.take(measurements.tracker, measurements.mocap)
            looked |= self.capture.compare()
        if measurements.gyro:
            looked |= self._feel(measurements.gyro[-1].stamp.t_ns)
        return self._doubts(measurements.t_ns) if looked else ()

    def radii(self, slip: WheelSlipCheck, drive_sign: tuple[int, ...]) -> WheelRadiusCheck:
        """The check of the radii, by the wheels' track of this check.

        Args:
            slip: check of wheels that begin to slip.
            drive_sign: sign of each drive, (4,).
        """
        return WheelRadiusCheck(self._geometry, self._wheels, slip, drive_sign)

    def slide(self) -> Slide:
        """The excess of camera and motion capture over the wheels, by the tracks of this check."""
        return Slide(self._wheels, self.capture.camera_track, self.capture.track)

    def leave_out(self, name: str) -> None:
        """Exclude a device from all comparisons."""
        self._left_out.add(name)

    @property
    def agreed(self) -> frozenset[str]:
        """Sensors that have agreed with another over at least 0.1 m."""
        ways = zip(self._ways, (self._way_m, *self.capture.ways_m), strict=True)
        agreed = [pair.names for pair, way_m in ways if way_m > _AGREE_M and not pair.suspicious]
        return frozenset(name for names in agreed for name in names) - self._left_out

    def _look(self, poses: tuple[PoseMeasurement, ...]) -> bool:
        """Add the step since the last compared camera pose; return whether a step was added.

        An invalid pose or a gap restarts the comparison: afterwards the camera's frame may have changed.
        """
        for pose in poses:
            if not pose.valid:
                self._seen = None
        if not poses or not poses[-1].valid:
            return False
        pose, before = poses[-1], self._seen
        t_ns = pose.stamp.t_ns
        if before is not None and 0 <= t_ns - before.t_ns < STEP_NS:
            return False
        wheels = self._wheels.at(t_ns)
        if wheels is None:
            return False
        x_m, y_m, heading_rad = pose.pose.tolist()
        now = _Seen(t_ns, complex(x_m, y_m), heading_rad, wheels, self._gyro.at(t_ns))
        self._seen = now
        if before is None or not 0 < t_ns - before.t_ns < _GAP_NS:
            return False
        return self._compare(before, now)

    def _compare(self, before: _Seen, now: _Seen) -> bool:
        """Add one step of camera, wheels and gyro, in the body's axes at its beginning."""
        h, t_ns = self.honest, before.t_ns
        dt_s = (now.t_ns - t_ns) / NS_PER_S
        way = (now.place - before.place) * cmath.rect(1.0, -before.heading_rad)
        turn = now.heading_rad - before.heading_rad
        rolling, turning = moved(before.wheels, now.wheels)
        path, loose = rolled(before.wheels, now.wheels)
        if self._leap.jumped(now.t_ns, abs(way - rolling), abs(turn - turning)):
            return False
        self._way_m += path
        allowed = h.path * path + h.lever_m * abs(turning) + h.rest_m_s * dt_s + loose
        lower = h.creep * path if self._on_wall else 0.0
        self._way.add(t_ns, way, rolling, allowed, cmath.rect(1.0, -turning), lower)
        scrub = h.turn * abs(turning) + h.turn_rad_m * path + loose / self._arm_m
        self._camera_wheels.add(t_ns, turn, turning, scrub + h.camera_rad_s * dt_s)
        if now.gyro is not None and before.gyro is not None and self._gyro.covers(t_ns):
            turned = (now.gyro[0] - before.gyro[0]).real
            drift = h.gyro * abs(turned) + (h.gyro_rad_s + h.camera_rad_s) * dt_s
            self._camera_gyro.add(t_ns, turn, turned, drift)
        return True

    def _feel(self, t_ns: int) -> bool:
        """Compare wheels and gyro without the camera; return whether a step was added."""
        before = self._felt
        if before is not None and 0 <= t_ns - before[0] < STEP_NS:
            return False
        wheels, gyro = self._wheels.at(t_ns), self._gyro.at(t_ns)
        if wheels is None or gyro is None:
            return False
        self._felt = (t_ns, wheels, gyro)
        if before is None or not 0 < t_ns - before[0] < _GAP_NS or not self._gyro.covers(before[0]):
            return False
        h, dt_s = self.honest, (t_ns - before[0]) / NS_PER_S
        turning, (path, loose) = (wheels[1] - before[1][1]).real, rolled(before[1], wheels)
        turned = (gyro[0] - before[2][0]).real
        allowed = h.turn * abs(turning) + h.turn_rad_m * path + loose / self._arm_m
        self._wheels_gyro.add(
            before[0], turning, turned, allowed + h.gyro * abs(turned) + h.gyro_rad_s * dt_s
        )
        return True

    def _doubts(self, t_ns: int) -> tuple[Disagreement, ...]:
        if not any([one.news() for one in self._sums]):
            return ()
        found = []
        for pairs in (self._ways, self._turns):
            believed = [one for one in pairs if self._left_out.isdisjoint(one.names)]
            turns = pairs is self._turns and self.capture.turns_with_wheels
            borne_out = WHEELS.name if turns and not self._left_out else ""
            found += [
                replace(one.doubt(t_ns, believed, borne_out), unseen=self.capture.unseen(one))
                for one in believed
                if one.news()
            ]
        return tuple(found)
