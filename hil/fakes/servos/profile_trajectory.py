"""The trajectory that a servo's firmware makes of a goal: step, ramp, rectangle, triangle or trapezoid.

Velocity-based profiles: Profile Velocity is the top speed, Profile Acceleration the slope; time-based:
the whole time and the time of acceleration, in ms. Zero means without limit (e-manual, profile section).
"""

from __future__ import annotations

import math

from hil.config.servo_models import ServoModel

STEP, RECTANGLE, TRIANGLE, TRAPEZOID = 0, 1, 2, 3

_MS = 1e-3
_ARRIVED = 0.05


class Trajectory:
    """Where position (counts) or velocity (velocity counts) should be now.

    Args:
        model: what the counts of goals and profiles are.

    Attributes:
        position, speed: position counts, and counts per second, of a position trajectory.
        velocity: velocity counts of a velocity trajectory.
        shape: `STEP`, `RECTANGLE`, `TRIANGLE` or `TRAPEZOID` of the latest position goal.
        ongoing: whether `advance` has something to do.
    """

    def __init__(self, model: ServoModel) -> None:
        acceleration = model.table["profile_acceleration"].scale
        self._speed_scale = model.rad_s_per_count / model.rad_per_count
        self._slope_scale = acceleration / model.rad_per_count
        self._ramp_scale = acceleration / model.rad_s_per_count
        self.rest(0.0)

    def rest(self, position: float) -> None:
        """Stand still at a position."""
        self.position, self.speed, self.velocity = position, 0.0, 0.0
        self._goal, self._top, self._slope = position, math.inf, math.inf
        self.shape, self.ongoing, self._turning = STEP, False, False

    def turn(self, goal: int, acceleration: int, timed: bool) -> None:
        """A new velocity goal."""
        self._goal, self._turning, self.shape = float(goal), True, STEP
        if not acceleration:
            self.velocity, self.ongoing = float(goal), False
            return
        change = abs(goal - self.velocity)
        self._slope = change / (acceleration * _MS) if timed else acceleration * self._ramp_scale
        self.ongoing = change > 0.0

    def move(self, goal: int, acceleration: int, velocity: int, timed: bool) -> None:
        """A new position goal, from wherever the trajectory is."""
        self._goal, self._turning = float(goal), False
        distance = abs(goal - self.position)
        if not velocity or distance == 0.0:
            self.position, self.speed = float(goal), 0.0
            self.shape, self.ongoing = STEP, False
            return
        if timed:
            rise = min(acceleration, velocity // 2) * _MS
            self._top = distance / (velocity * _MS - rise)
            # A goal close by has a low top: a servo that comes in fast has to brake in that time, too.
            self._slope = max(self._top, abs(self.speed)) / rise if rise else math.inf
        else:
            self._top = velocity * self._speed_scale
            self._slope = acceleration * self._slope_scale if acceleration else math.inf
        self.ongoing = True
        if math.isinf(self._slope):
            self.shape = RECTANGLE
        else:
            self.shape = TRIANGLE if distance * self._slope < self._top**2 else TRAPEZOID

    def advance(self, dt_s: float) -> None:
        """Follow the profile for `dt_s`."""
        if self._turning:
            step = self._slope * dt_s
            self.velocity += min(max(self._goal - self.velocity, -step), step)
            self.ongoing = self.velocity != self._goal
            return
        left = self._goal - self.position
        before = self.speed
        wanted = self._approach(abs(left), math.copysign(before, before * left), dt_s)
        wanted = math.copysign(min(wanted, self._top), left)
        step = self._slope * dt_s
        self.speed += min(max(wanted - before, -step), step)
        moved = 0.5 * (before + self.speed) * dt_s if math.isfinite(step) else self.speed * dt_s
        if abs(left) <= _ARRIVED or (moved * left > 0 and abs(moved) >= abs(left)):
            self.position, self.speed, self.ongoing = self._goal, 0.0, False
        else:
            self.position += moved

    def _approach(self, left: float, before: float, dt_s: float) -> float:
        """Largest speed at the end of a step from which the remaining distance is enough to brake.

        With v the speed after the step and u before it, v^2 / 2a + (u + v) dt / 2 = left.
        """
        if math.isinf(self._slope):
            return math.inf
        half = 0.5 * self._slope * dt_s
        room = half * half + 2.0 * self._slope * (left - 0.5 * before * dt_s)
        return max(0.0, math.sqrt(room) - half) if room > 0.0 else 0.0
