"""Detects that the robot has detached or slides, by IMU and camera."""

import math
from collections.abc import Mapping, Sequence

from hil.core.interfaces import ReportStop
from hil.core.signals import Inputs, Status
from hil.loop.cycle_data import Check, Cycle

_OK = Status.OK
_SAMPLES = 3
_SEEN_BY = {"adhesion": "imu", "sliding": "tracker"}
"""The kind whose samples show that the robot has detached (`adhesion`), or slides."""


def look_at(holders: Mapping[str, str], begin: str) -> str:
    """Text to append: advice to check the devices that hold the robot; empty without such devices."""
    return f"; {begin} at the {' and the '.join(holders.values())}" if holders else ""


class FallCheck(Check):
    """Checks one run: a detached robot is weightless; a sliding one is faster than it can drive.

    Args:
        lightest_m_s2: specific force below which the robot is falling.
        fastest_m_s: largest plausible speed by the camera.
        holders: devices that keep the robot on its surface: noun by kind.
        rests_on: keys of the bench file that scale what holds the robot, and that nothing confirms.
    """

    def __init__(
        self,
        lightest_m_s2: float,
        fastest_m_s: float,
        holders: Mapping[str, str] | None = None,
        rests_on: Sequence[str] = (),
    ) -> None:
        self._lightest_m_s2, self._fastest_m_s = lightest_m_s2, fastest_m_s
        self._holders = holders or {}
        self._rests_on = tuple(rests_on)
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._weightless = self._sliding = 0

    @property
    def falls(self) -> bool:
        """Whether the accelerometer felt clearly less than the weight in its newest sample."""
        return self._weightless > 0

    def on_samples(self, cycle: Cycle) -> None:
        """Check IMU and camera; the suspects are the devices that hold the robot."""

        def stop(reason: str, message: str) -> None:
            suspects = (*self._holders, _SEEN_BY[reason])
            look = look_at(self._holders, "look")
            if look and self._rests_on:
                look += f", and if they run as they should, at {', '.join(self._rests_on)}"
            cycle.stop(reason, message + look, suspects)

        self.judge(cycle.inputs, stop)

    def judge(self, inputs: Inputs, stop: ReportStop) -> None:
        """Check one cycle's samples; calls `stop` with the reason to stop."""
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
