"""Sees that the robot has come off or slides, by what it feels and by what the camera sees."""

from __future__ import annotations

import math

from hil.vocabulary.interfaces import Blame
from hil.vocabulary.signals import Inputs, Status

_OK = Status.OK
_SAMPLES = 3


class FallWatch:
    """Follows one run: a robot that has come off is weightless; one that slides is faster than it can drive.

    Args:
        lightest_m_s2: specific force below which it is falling.
        fastest_m_s: speed that the camera may see.
    """

    def __init__(self, lightest_m_s2: float, fastest_m_s: float) -> None:
        self._lightest_m_s2, self._fastest_m_s = lightest_m_s2, fastest_m_s
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._weightless = self._sliding = 0

    def judge(self, inputs: Inputs, stop: Blame) -> None:
        """Look at one cycle's samples; `stop` is called with the reason to stop."""
        for imu in inputs.imu:
            if imu.status is _OK:
                light = math.hypot(*imu.specific_force_m_s2.tolist()) < self._lightest_m_s2
                self._weightless = self._weightless + 1 if light else 0
        for tracker in inputs.tracker:
            if tracker.status is _OK:
                fast = math.hypot(*tracker.velocity_m_s.tolist()) > self._fastest_m_s
                self._sliding = self._sliding + 1 if fast else 0
        if self._weightless >= _SAMPLES:
            stop("adhesion", "the accelerometer feels less than the weight: adhesion is lost")
        if self._sliding >= _SAMPLES:
            stop("sliding", f"the camera sees more than {self._fastest_m_s:g} m/s: no hold")
