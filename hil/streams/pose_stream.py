"""Judges a stream of poses, whatever sends them: times, plausible values, stuck values, jumps, restarts."""

import math
from collections.abc import Sequence
from math import hypot
from typing import Any

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.signals import Status
from hil.streams.device_clock import DeviceClock
from hil.streams.pose_jumps import JumpTest
from hil.streams.stuck_values import StuckTest

USABLE_CONFIDENCE = 2
"""Confidence, 0 (failed) to 3 (high), from which a pose is used."""
WITHOUT_POSE = (Status.NOT_FINITE, Status.IMPLAUSIBLE, Status.NOT_TRACKED)
"""States of poses whose values mean nothing."""
_NORM_LOW, _NORM_HIGH = 0.98, 1.02
_FARTHEST_M, _FASTEST = 1000.0, 100.0
_OK = Status.OK


class PoseStream:
    """State of one stream of poses.

    Args:
        table: the sensor's table of the bench file: `stale_after_s`, `stuck_after_s`, and the limits of
            `JumpTest.of`.
        latency_s: smallest delay from measurement to arrival, s.

    Attributes:
        clock_map: map from the sensor's time to bench time.
    """

    def __init__(self, table: Any, latency_s: float) -> None:
        self.clock_map = DeviceClock(nanoseconds(latency_s))
        self._jumps, self._stuck = JumpTest.of(table), StuckTest(table.stuck_after_s)
        self._stale_ns = nanoseconds(table.stale_after_s)
        self._restarted = False

    def begin(self, now_ns: int) -> None:
        """Forget all poses: the sensor was opened."""
        self.clock_map.reset()
        self._jumps.reset()
        self._restarted = False
        self.wait(now_ns)

    def wait(self, now_ns: int) -> None:
        """Count the time of stuck values from now on."""
        self._stuck.reset(now_ns)

    def begin_again(self) -> None:
        """The frame of the poses may have changed: the next usable pose has status RESET."""
        self._jumps.distrust()
        self._restarted = True

    def status(
        self,
        pose: Sequence[float],
        twist: Sequence[float],
        confidence: int,
        t_ns: int,
        host_ns: int,
        credible: bool,
    ) -> Status:
        """Status of the next pose.

        Args:
            pose: position m and quaternion, w first (7).
            twist: velocities m/s and rates rad/s, as far as they are measured.
            confidence: 0 (failed) to 3 (high).
            t_ns: bench time of the pose.
            host_ns: time of its arrival.
            credible: True if the sensor's own stamp gave `t_ns`.
        """
        status = self._by_values(pose, twist, confidence, t_ns, host_ns)
        if status is _OK:
            return _OK if credible and host_ns - t_ns <= self._stale_ns else Status.STALE
        if status is Status.JUMP and self._restarted:
            self._restarted = False
            return Status.RESET
        return status

    def _by_values(
        self, pose: Sequence[float], twist: Sequence[float], confidence: int, t_ns: int, host_ns: int
    ) -> Status:
        x, y, z, qw, qx, qy, qz = pose
        right = _NORM_LOW < hypot(qw, qx, qy, qz) < _NORM_HIGH and hypot(x, y, z) < _FARTHEST_M
        if not (right and hypot(*twist) < _FASTEST):
            if not all(map(math.isfinite, (*pose, *twist))):
                return Status.NOT_FINITE
            if not (right and max(map(abs, twist), default=0.0) < _FASTEST):
                return Status.IMPLAUSIBLE
        if self._stuck.stuck(pose, host_ns):
            return Status.FROZEN
        if confidence <= 0:
            return Status.NOT_TRACKED
        if confidence < USABLE_CONFIDENCE:
            return Status.LOW_CONFIDENCE
        if self._jumps.jumped(t_ns / NS_PER_S, (x, y, z), (qw, qx, qy, qz)):
            return Status.JUMP
        return _OK
