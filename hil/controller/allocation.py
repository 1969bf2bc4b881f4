"""The module layer: from a body twist to four wheel speeds and steering angles, in one fixed order.

1. inverse kinematics; 2. a wheel that hardly moves holds its last angle (a centre of rotation on a
wheel is singular); 3. flip by half a turn when that is the shorter turn from the **measured** angle,
with hysteresis; 4. keep inside the steering range, else flip; 5. cosine compensation; 6. desaturate
all wheels alike, which keeps the centre of rotation; 7. steering rate limit: all modules are slowed alike
and arrive together; 8. slow all wheels alike while their angles, on the way to a new centre of rotation,
contradict each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.robot.kinematics import WheelGeometry, inverse, wheel_vectors
from hil.vocabulary.geometry import Array, wrap, wrap_array
from hil.vocabulary.signals import WheelSetpoint

_QUARTER_RAD = np.pi / 2.0
_FOLLOWING = 0.9


@dataclass(frozen=True)
class ModuleLimits:
    """Limits of a steered and driven wheel."""

    speed_m_s: float = 0.122
    steering_rad: float = 2.0944
    steering_rate_rad_s: float = 5.0
    still_speed_m_s: float = 0.002
    flip_hysteresis_rad: float = 0.1047
    contradiction_m_s: float = 0.004


def optimize(
    speed: float, angle_rad: float, measured_rad: float, limits: ModuleLimits
) -> tuple[float, float]:
    """Speed and the equivalent angle nearest to the measured one, within the steering range.

    Never asks for a turn of more than a quarter plus the hysteresis unless the range forces it.

    Args:
        speed: of the wheel, signed, m/s.
        angle_rad: steering angle wanted.
        measured_rad: steering angle now.
        limits: of the module.
    """
    near = measured_rad + wrap(angle_rad - measured_rad)
    if abs(near - measured_rad) > _QUARTER_RAD + limits.flip_hysteresis_rad:
        near, speed = near - math.copysign(math.pi, near - measured_rad), -speed
    if abs(near) > limits.steering_rad:
        near, speed = near - math.copysign(math.pi, near), -speed
    return speed, near


def desaturate(values: Array, limit: float) -> Array:
    """All values (4,) scaled by one factor so that none exceeds the limit."""
    peak = max(map(abs, values.tolist()))
    return values if peak <= limit else values * (limit / peak)


def _clipped(values: Array, limit: float) -> Array:
    """Values within -limit and limit, without what `np.clip` spends on its arguments."""
    return np.asarray(np.minimum(np.maximum(values, -limit), limit), dtype=np.float64)


class ModuleLayer:
    """Keeps each module's held angle between calls.

    Args:
        geometry: of the wheels.
        limits: of the modules.
        dt_s: period of the loop, s.

    Attributes:
        following: whether the latest twist is what the wheels were told to do: not held, limited or slowed.
    """

    def __init__(self, geometry: WheelGeometry, limits: ModuleLimits, dt_s: float) -> None:
        self.geometry, self.limits, self.dt_s = geometry, limits, dt_s
        p = geometry.projection()
        self._contradicting = np.eye(8) - p @ np.linalg.pinv(p)
        self.reset()

    def reset(self) -> None:
        """Forget held and sent angles: they start again from the measured ones."""
        self.following = False
        self._held: Array | None = None
        self._sent: Array | None = None

    def hold(self, measured_rad: Array) -> WheelSetpoint:
        """Wheels at rest at the held, or else the measured, steering angles (4,), rad."""
        held = measured_rad.copy() if self._held is None else self._held
        self._held = self._sent = held
        self.following = False
        return WheelSetpoint(np.zeros(4), held.copy())

    def allocate(self, twist_body: Array, measured_rad: Array) -> WheelSetpoint:
        """Setpoint for a twist (3,) given the measured steering angles (4,)."""
        held = measured_rad if self._held is None else self._held
        goals, measured, limits = held.tolist(), measured_rad.tolist(), self.limits
        speeds, angles = (values.tolist() for values in inverse(self.geometry, twist_body))
        for i in range(4):
            if speeds[i] < limits.still_speed_m_s:
                speeds[i] = 0.0
                continue
            speeds[i], goals[i] = optimize(speeds[i], angles[i], measured[i], limits)
        asked, target = np.array(speeds), np.array(goals)
        self._held = target
        error = wrap_array(target - measured_rad)
        speed = desaturate(asked * np.maximum(0.0, np.cos(error)), limits.speed_m_s)
        reach = limits.steering_rate_rad_s * self.dt_s
        sent = measured_rad if self._sent is None else self._sent
        self._sent = sent + desaturate(target - sent, reach)
        bounded = _clipped(self._sent, limits.steering_rad)
        speed = self._agreeing(speed, np.stack([measured_rad, bounded]))
        self.following = bool(np.any(asked) and np.all(np.abs(speed) >= _FOLLOWING * np.abs(asked)))
        return WheelSetpoint(speed / self.geometry.radius_m, bounded)

    def _agreeing(self, speed: Array, steering_rad: Array) -> Array:
        """Speeds (4,) scaled by one factor so that no wheel slips by more than the limit.

        What a wheel slips is what the rigid-body motion that fits all wheels best, by least squares,
        leaves of its velocity; at each of the steering angles (n, 4) that the wheels may have meanwhile.
        """
        u = wheel_vectors(speed, steering_rad - self.geometry.steering_zero_rad)
        left = u @ self._contradicting
        peak = float(np.max(np.hypot(left[:, 0::2], left[:, 1::2])))
        limit = self.limits.contradiction_m_s
        return speed if peak <= limit else speed * (limit / peak)
