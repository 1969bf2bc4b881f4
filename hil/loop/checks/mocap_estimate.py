"""Compares the estimate with motion capture over the whole run, where a slowly growing error adds up.

Camera, wheels and motion capture may differ by some per cent of every step without being in doubt
(`hil.loop.checks.mocap_agreement`), and the estimate from two of them may depend on the wrong one. So its
displacement since the start of the run is compared with that of motion capture, which does not enter the
estimate. The covariance is increased by the difference, so that it covers the truth; if the difference grows
further, the robot stops. Deterministic: depends only on the estimates and poses since `reset`.
"""

import cmath
import math
from collections.abc import Container

from hil.core.interfaces import ReportStop
from hil.core.signals import Event, RobotState
from hil.loop.checks.cusum import CAMERA, STEP_NS, WHEELS, MotionSource, Relocalisation
from hil.loop.checks.dead_reckoning import Kept, Track
from hil.loop.checks.mocap_agreement import CAPTURE, GAP_NS, MocapAgreement
from hil.loop.cycle_data import Check, Cycle

_SIGMAS, _SLACK_M, _WARN_M, _QUIET_M = 3.0, 0.0043, 0.006, 0.002
"""An error within this number of sigmas plus this slack counts as covered (5 mm are specified). A warning is
given at this excess, as robots as delivered reach 5.2 mm; until then the covariance is only increased by
the last value.
"""
_STOP_M = 0.015
"""Excess error at which the robot must stop: the path error by which every wrong sensor must be found."""
_KEPT_NS = 38_000_000
"""Shortest interval of stored estimates: between two of them the path is straight to 0.04 mm."""
_LEANS = 0.5
"""Smallest share of the estimate's error in a device that makes it the cause."""


class MocapEstimate(Check):
    """Checks the estimate of one run.

    Args:
        capture: history of the poses of motion capture, and of the displacements of camera and wheels.
        follows: True if control uses this estimate; else it only warns.

    Attributes:
        required: the sensor without which the estimate is not checked.
        accused: devices that may be wrong when the robot stops.
        excluded: devices that are excluded in this run.
        advice: end of a stop's message: what else to check.
        holders: devices that hold the robot: it may slide.
    """

    required = CAPTURE.name
    accused: tuple[str, ...] = ()
    excluded: Container[str] = ()
    advice = ""
    holders: tuple[str, ...] = ()

    def __init__(self, capture: MocapAgreement, *, follows: bool) -> None:
        self._capture, self._follows = capture, follows
        self._states, self._leap = Track(), Relocalisation()
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._states.reset()
        self._leap.reset()
        self._last: tuple[int, Kept, Kept] | None = None
        self._gone = self._true = 0j
        self._turn_rad = self._turn_sigma_rad = self._turned_rad = 0.0
        self._off_m = self._widened_m2 = 0.0
        self._known = False

    def take_inflation(self) -> tuple[float, float]:
        """Estimate error found since the last call (m, rad); resets it."""
        off_m, self._off_m = self._off_m, 0.0
        self._widened_m2 += off_m**2
        return off_m, 0.0

    def on_estimate(self, cycle: Cycle) -> None:
        """Compare the estimate with motion capture, unless that is excluded."""
        assert cycle.state is not None
        if self.required not in self.excluded:
            self.judge(cycle.state, cycle.events, lambda reason, message: self._stop(cycle, reason, message))
            cycle.inflate_next(self.take_inflation())

    def _stop(self, cycle: Cycle, reason: str, message: str) -> None:
        cycle.stop(reason, message + self.advice, (*self.accused, *self.holders))

    def judge(self, state: RobotState, events: list[Event], stop: ReportStop) -> None:
        """Check one cycle's estimate; adds findings to `events`, or calls `stop`.

        A warning increases the covariance so that it covers the possible error until the robot stops.
        """
        kept_ns = self._states.newest_ns
        if kept_ns is not None and state.t_ns - kept_ns < _KEPT_NS:
            return
        x_m, y_m, heading_rad = state.pose_body_in_wall.tolist()
        self._states.put(state.t_ns, (complex(x_m, y_m), heading_rad))
        if self._step(state):
            self._compare(state, events, stop)

    def _step(self, state: RobotState) -> bool:
        """Add a step of both displacements; return whether enough time has passed and both were measured.

        After a gap the rigid body may have changed: the axes are aligned again, and no step is added.
        """
        track, before = self._capture.track, self._last
        newest_ns = track.newest_ns
        if newest_ns is None:
            return False
        t_ns = min(newest_ns, state.t_ns)
        if before is not None and 0 <= t_ns - before[0] < STEP_NS:
            return False
        now, seen = self._states.at(t_ns), track.at(t_ns)
        if now is None or seen is None:
            return False
        self._last = (t_ns, now, seen)
        if before is None or not 0 < t_ns - before[0] < GAP_NS or not track.covers(before[0]):
            self._turn_rad = (now[1] - seen[1]).real
            self._turn_sigma_rad = math.sqrt(max(state.covariance.item(2, 2), 0.0))
            return False
        step = now[0] - before[1][0]
        true = (seen[0] - before[2][0]) * cmath.rect(1.0, self._turn_rad)
        turned = (seen[1] - before[2][1]).real
        if abs(true) > abs(step) and self._leap.jumped(t_ns, abs(true - step), 0.0):
            return False
        self._gone, self._true = self._gone + step, self._true + true
        self._turned_rad += turned
        return True

    def _compare(self, state: RobotState, events: list[Event], stop: ReportStop) -> None:
        """Compare the displacements of estimate and motion capture.

        The error along the wall's axes shows whether the sigmas cover it; the error along and across the path
        decides on a stop. Lengths do not depend on a rotation between the axes. Across the path, its possible
        effect is added to the covariance, and is no reason to stop.
        """
        way_m, seen, off = abs(self._true), self._capture.allowed, self._gone - self._true
        unit = self._true / way_m if way_m else 1.0 + 0j
        c, s = abs(unit.real), abs(unit.imag)
        variances = [max(state.covariance.item(k, k), 0.0) for k in (0, 1)]
        own = [_SIGMAS * math.sqrt(max(v - self._widened_m2, 0.0)) for v in variances]
        now = [_SIGMAS * math.sqrt(v) for v in variances]
        beside = seen.lever_m * 2.0 * abs(math.sin(0.5 * self._turned_rad))
        leaned_m = 0.0 if self._known else _SIGMAS * self._turn_sigma_rad * way_m
        left = abs(off.real) - beside - leaned_m * s, abs(off.imag) - beside - leaned_m * c
        uncovered = max(left[0] - now[0], left[1] - now[1]) > _SLACK_M
        found = max(left[0] - own[0], left[1] - own[1]) > _WARN_M
        along_m = abs(abs(self._gone) - way_m) - c * own[0] - s * own[1]
        across_m = abs((self._gone / unit).imag) - seen.across * way_m - s * own[0] - c * own[1]
        beyond_m = max(along_m, across_m) - beside - _SLACK_M
        if found and (uncovered or not self._known):
            self._known, self._off_m = True, max(abs(off), (abs(off) + _STOP_M) / _SIGMAS)
            party = self._whom(off)
            more = f"; the estimate is unsure by {1e3 * self._off_m:.0f} mm more"
            said = self._text(off / unit, beyond_m, party) + more
            events.append(Event(state.t_ns, "warning", party.name, said))
        elif uncovered:
            self._off_m = _QUIET_M
        if beyond_m > _STOP_M and self._follows and (party := self._whom(off)) is not CAPTURE:
            self.accused = (party.name, CAPTURE.name)
            stop("sensors_disagree", self._text(off / unit, beyond_m, party))

    def _whom(self, off: complex) -> MotionSource:
        """The device that caused the error of the estimate, by its displacement relative to motion capture.

        If camera and wheels both have the error of the estimate, they agree against motion capture.
        """
        size_m2 = max(abs(off) ** 2, 1e-12)
        axes = cmath.rect(1.0, self._turn_rad)
        camera, wheels = (
            ((error * axes) * off.conjugate()).real / size_m2 for error in self._capture.errors()
        )
        if min(camera, wheels) > _LEANS:
            return CAPTURE
        return CAMERA if camera > wheels else WHEELS

    def _text(self, off: complex, beyond_m: float, party: MotionSource) -> str:
        """Message with the displacements of all devices.

        Args:
            off: error of the estimate along the path and across it, m.
            beyond_m: error beyond what rotated axes explain, m.
            party: the device that may be wrong.
        """
        gone_m, true_m = abs(self._gone), abs(self._true)
        camera_m, wheels_m = (abs(way) for way in self._capture.ways())
        message = f"the estimate has gone {gone_m:.3f} m, motion capture {true_m:.3f} m"
        if abs(off.imag) > abs(off.real):
            message += f" and {1e3 * abs(off.imag):.0f} mm further aside"
        message += f" (the camera {camera_m:.3f} m, the wheels {wheels_m:.3f} m)"
        if beyond_m <= 0.0:
            return (
                f"{message}: camera or wheels drift, or the axes of motion capture's rigid body are turned "
                "against the robot's; align them"
            )
        if party is CAPTURE:
            return f"{message}: camera and wheels agree against motion capture"
        return f"{message}: {party.called} may be wrong, or motion capture is"
