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
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.robot.kinematics import WheelGeometry, inverse
from hil.vocabulary.geometry import Array, wrap
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


def desaturate(values: Sequence[float], limit: float) -> list[float]:
    """All values scaled by one factor so that none exceeds the limit."""
    peak = max(map(abs, values))
    return list(values) if peak <= limit else [value * (limit / peak) for value in values]


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
        self._zeros = 2 * geometry.steering_zero_rad.tolist()
        self._radius_m = geometry.radius_m.tolist()
        self.reset()

    def reset(self) -> None:
        """Forget held and sent angles: they start again from the measured ones."""
        self.following = False
        self._held: list[float] | None = None
        self._sent: list[float] | None = None

    def hold(self, measured_rad: Array) -> WheelSetpoint:
        """Wheels at rest at the held, or else the measured, steering angles (4,), rad."""
        held = measured_rad.tolist() if self._held is None else self._held
        self._held = self._sent = held
        self.following = False
        return WheelSetpoint(np.zeros(4), np.array(held))

    def allocate(self, twist_body: Array, measured_rad: Array) -> WheelSetpoint:
        """Setpoint for a twist (3,) given the measured steering angles (4,).

        Four values a step: plain floats are quicker than arrays, and give the same bits in sums and
        products. Sine, cosine, angle, hypotenuse and matrix product stay numpy's, whose last bit may differ;
        `dot` is the product of `@` at a third of its cost.
        """
        measured: list[float] = measured_rad.tolist()
        asked, target = self._wanted(twist_body, measured)
        self._held = target
        reach = self.limits.steering_rate_rad_s * self.dt_s
        sent = measured if self._sent is None else self._sent
        step = desaturate([goal - at for goal, at in zip(target, sent, strict=True)], reach)
        self._sent = sent = [at + more for at, more in zip(sent, step, strict=True)]
        widest = self.limits.steering_rad
        bounded = sent
        if max(sent) > widest or min(sent) < -widest:
            bounded = [min(max(angle, -widest), widest) for angle in sent]
        headings = [angle - zero for angle, zero in zip(measured + bounded, self._zeros, strict=True)]
        error = [wrap(goal - now) for goal, now in zip(target, measured, strict=True)]
        turned = np.array(error + headings)
        cosines = np.cos(turned).tolist()
        speed = [v * max(0.0, part) for v, part in zip(asked, cosines[:4], strict=True)]
        speed = desaturate(speed, self.limits.speed_m_s)
        speed = self._agreeing(speed, cosines[4:], np.sin(turned[4:]).tolist())
        self.following = any(asked) and all(
            [abs(v) >= _FOLLOWING * abs(wanted) for v, wanted in zip(speed, asked, strict=True)]
        )
        rates = [v / radius for v, radius in zip(speed, self._radius_m, strict=True)]
        return WheelSetpoint(np.array(rates), np.array(bounded))

    def _wanted(self, twist_body: Array, measured: list[float]) -> tuple[list[float], list[float]]:
        """Signed speeds (4,) and angles (4,) of a twist (3,): those nearest to the measured angles."""
        goals = list(measured if self._held is None else self._held)
        speeds, angles = (values.tolist() for values in inverse(self.geometry, twist_body))
        for i in range(4):
            if speeds[i] < self.limits.still_speed_m_s:
                speeds[i] = 0.0
            else:
                speeds[i], goals[i] = optimize(speeds[i], angles[i], measured[i], self.limits)
        return speeds, goals

    def _agreeing(self, speed: list[float], cosines: list[float], sines: list[float]) -> list[float]:
        """Speeds (4,) scaled by one factor so that no wheel slips by more than the limit.

        What a wheel slips is what the rigid-body motion that fits all wheels best, by least squares,
        leaves of its velocity; at the angles that the wheels have and at those that they are sent to.

        Args:
            speed: of the wheels, m/s.
            cosines: (8,) of the wheels' headings at the first angles, then at the others.
            sines: (8,) of the same.
        """
        u: list[float] = []
        for v, cosine, sine in zip(speed + speed, cosines, sines, strict=True):
            u += (v * cosine, v * sine)
        left = np.array(u).reshape(2, 8).dot(self._contradicting).reshape(8, 2)
        peak = max(np.hypot(left[:, 0], left[:, 1]).tolist())
        limit = self.limits.contradiction_m_s
        return speed if peak <= limit else [v * (limit / peak) for v in speed]
