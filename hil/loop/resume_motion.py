"""Resumes the motion from rest after a pause of the loop in which the wheels were stopped.

The servos' bus watchdogs stop the wheels during the pause. So the reference waits, too, and starts again from
rest; no wheel is commanded faster than the acceleration limit permits, nor much faster than it is measured to
turn. Deterministic: depends only on the times of the cycles and on the measured wheels.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import SafetyStop
from hil.core.geometry import Array, rotation2
from hil.core.signals import Reference, WheelMeasurement, WheelSetpoint

_LAGS = 2.0
"""Permitted lead of the commanded wheel speed, as acceleration times this number of servo lags."""
_STANDS_NS = 5 * NS_PER_S
"""Longest time of nothing but pauses, ns."""


class Restart:
    """Delays and restarts the reference of one run.

    Args:
        after_s: bus silence after which the servos stop the wheels, s.
        acceleration_m_s2: acceleration limit of a wheel.
        speed_m_s: speed limit of a wheel.
        lag_s: lag of the servos.
        radius_m: (4,) wheel radii.

    Attributes:
        waited_ns: total delay of the reference since `reset`.
    """

    def __init__(
        self, after_s: float, acceleration_m_s2: float, speed_m_s: float, lag_s: float, radius_m: Array
    ) -> None:
        self._after_ns, self._radius_m = nanoseconds(after_s), radius_m
        self._acceleration_m_s2, self._per_s = acceleration_m_s2, acceleration_m_s2 / speed_m_s
        self._ahead_m_s = _LAGS * lag_s * acceleration_m_s2
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self.waited_ns = 0
        self._last_ns: int | None = None
        self._pace, self._quicker, self._step_s = 1.0, 0.0, 0.0
        self._stood_ns = 0
        self._most_m_s: float | None = None

    def judge(self, t_ns: int) -> None:
        """Process the time of a cycle; after a pause, delay the reference.

        Raises:
            SafetyStop: `held_up`, there have been nothing but pauses for too long.
        """
        step_ns = 0 if self._last_ns is None else t_ns - self._last_ns
        self._last_ns, self._step_s = t_ns, step_ns / NS_PER_S
        self._stood_ns = self._stood_ns + step_ns if step_ns > self._after_ns else 0
        if self._stood_ns > _STANDS_NS:
            raise SafetyStop(
                "held_up",
                f"for {self._stood_ns / NS_PER_S:.0f} s no cycle of the control loop took less than "
                f"{self._after_ns / NS_PER_S:g} s (servos.watchdog_s), and the wheels stand: "
                "look for what holds it up, or takes the processor from it",
            )
        if step_ns > self._after_ns:
            self.waited_ns += step_ns - round(self._pace * self._after_ns)
            self._pace, self._quicker, self._step_s = 0.0, self._per_s, 0.0
            self._most_m_s = 0.0
        elif self._pace < 1.0:
            pace = min(1.0, self._pace + self._per_s * self._step_s)
            self.waited_ns += round(step_ns * (1.0 - 0.5 * (self._pace + pace)))
            self._pace = pace
        elif self._quicker:
            self._quicker = 0.0

    def paced(self, sample: Callable[[float], Reference]) -> Callable[[float], Reference]:
        """Make a reference that waits during a pause, and starts again from rest.

        Args:
            sample: the reference without pauses, by seconds since the first cycle.
        """

        def reference(t_s: float) -> Reference:
            if not self.waited_ns:
                return sample(t_s)
            found, pace = sample(t_s - self.waited_ns / NS_PER_S), self._pace
            if not self._quicker:
                return found
            along = found.twist_body.copy()
            along[:2] = rotation2(float(found.pose_in_wall[2])) @ along[:2]
            return replace(
                found,
                twist_body=pace * found.twist_body,
                acceleration_wall=pace**2 * found.acceleration_wall + self._quicker * along,
            )

        return reference

    def limit(self, setpoint: WheelSetpoint, wheels: WheelMeasurement | None) -> WheelSetpoint:
        """Scale all wheel rates down equally if one would exceed its limit after a pause.

        Args:
            setpoint: setpoint of the controller.
            wheels: newest aligned wheels; None where none were read.
        """
        if self._most_m_s is None:
            return setpoint
        most_m_s = self._most_m_s + self._acceleration_m_s2 * self._step_s
        if wheels is not None and np.isfinite(wheels.wheel_rate_rad_s).all():
            turning_m_s = float(np.abs(wheels.wheel_rate_rad_s * self._radius_m).max())
            most_m_s = min(most_m_s, turning_m_s + self._ahead_m_s)
        self._most_m_s = most_m_s
        fastest_m_s = float(np.abs(setpoint.wheel_rate_rad_s * self._radius_m).max())
        if fastest_m_s > most_m_s:
            return WheelSetpoint(setpoint.wheel_rate_rad_s * (most_m_s / fastest_m_s), setpoint.steering_rad)
        if self._pace >= 1.0:
            self._most_m_s = None
        return setpoint
