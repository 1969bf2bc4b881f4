"""The module layer: computes four wheel speeds and steering angles from a body twist, in a fixed order.

1. inverse kinematics; 2. a wheel that hardly moves holds its last angle (a centre of rotation on a
wheel is singular); 3. flip by half a turn when that is the shorter turn from the **measured** angle,
with hysteresis; 4. keep inside the steering range, else flip; 5. cosine compensation; 6. desaturate
all wheels alike, which keeps the centre of rotation; 7. steering rate limit: all modules are slowed alike
and arrive together; 8. slow all wheels alike while their angles, on the way to a new centre of rotation,
contradict each other.
"""

import numpy as np

from hil.controller import module_arithmetic as at
from hil.controller.module_arithmetic import ModuleLimits, drive, optimize, steer
from hil.core.geometry import Array
from hil.core.signals import WheelSetpoint
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import compile_for, plain

__all__ = ["ModuleLayer", "ModuleLimits", "optimize"]

_SURELY = 0.999
"""A value below this share of a limit is below it whatever the rounding of its sum."""


class ModuleLayer:
    """Turns body twists into wheel setpoints; stores each module's held angle between calls.

    Args:
        geometry: calibrated wheel parameters.
        limits: limits of the modules.
        dt_s: period of the loop, s.

    Attributes:
        following: True if the wheels were commanded the latest twist in full: not held, limited or slowed.
    """

    def __init__(self, geometry: WheelGeometry, limits: ModuleLimits, dt_s: float) -> None:
        self.geometry, self.limits, self.dt_s = geometry, limits, dt_s
        self._reach_rad = limits.steering_rate_rad_s * dt_s
        p = geometry.projection()
        self._vectors_of_twist, self._contradicting = p.T, np.eye(8) - p @ np.linalg.pinv(p)
        n = self._numbers = np.zeros(at.SIZE)
        n[at.ZERO : at.ZERO + 4], n[at.RADIUS : at.RADIUS + 4] = geometry.steering_zero_rad, geometry.radius_m
        n[at.CONTRADICTING :] = self._contradicting.ravel()
        self._wanted = np.zeros(8)
        self._wanted_x, self._wanted_y = self._wanted[0::2], self._wanted[1::2]
        self._speed, self._angle = n[at.SPEED : at.SPEED + 4], n[at.ANGLE : at.ANGLE + 4]
        self._measured, self._rate = n[at.MEASURED : at.MEASURED + 4], n[at.RATE : at.RATE + 4]
        self._held, self._sent = n[at.HELD : at.HELD + 4], n[at.SENT : at.SENT + 4]
        self._turned, self._cosines = n[at.TURNED : at.TURNED + 12], n[at.COSINE : at.COSINE + 12]
        self._headings, self._sines = self._turned[4:], n[at.SINE : at.SINE + 8]
        self._next, self._rolled = n[at.NEXT : at.NEXT + 4], n[at.ROLLED : at.ROLLED + 16].reshape(2, 8)
        self._limits = plain(limits)
        compile_for(steer, n, self._limits, self._reach_rad)
        compile_for(drive, n, self._limits, 1.0)
        self.reset()

    def reset(self) -> None:
        """Discard held and sent angles; they start again from the measured ones."""
        self.following = self._holds = False

    def hold(self, measured_rad: Array) -> WheelSetpoint:
        """Setpoint with the wheels at rest, at the held or else the measured steering angles (4,), rad."""
        self._begin(measured_rad)
        self._sent[:] = self._held
        self.following = False
        return WheelSetpoint(np.zeros(4), self._held.copy())

    def _begin(self, measured_rad: Array) -> None:
        """Set held and sent angles to the measured ones where none are held yet."""
        if not self._holds:
            self._held[:] = self._sent[:] = measured_rad
            self._holds = True

    def allocate(self, twist_body: Array, measured_rad: Array) -> WheelSetpoint:
        """Setpoint for a body twist (3,), given the measured steering angles (4,), rad.

        numpy computes sine, cosine, angle, hypotenuse and matrix product: compiled code may differ in the
        last bit. `dot` gives the product of `@` at a third of its cost.
        """
        n, limits = self._numbers, self.limits
        self._begin(measured_rad)
        self._measured[:] = measured_rad
        twist_body.dot(self._vectors_of_twist, self._wanted)
        np.hypot(self._wanted_x, self._wanted_y, self._speed)
        np.arctan2(self._wanted_y, self._wanted_x, self._angle)
        steer(n, self._limits, self._reach_rad)
        np.cos(self._turned, self._cosines)
        np.sin(self._headings, self._sines)
        slip, self.following = drive(n, self._limits, 1.0)
        if not slip < _SURELY * limits.contradiction_m_s:
            self._slow()
        return WheelSetpoint(self._rate.copy(), self._next.copy())

    def _slow(self) -> None:
        """Slow all wheels alike, so that no wheel slips by more than the limit.

        The slip of a wheel is the residual of its velocity from the least-squares rigid-body motion, at the
        measured and at the commanded steering angles.
        """
        left = self._rolled.dot(self._contradicting).reshape(8, 2)
        peak = max(np.hypot(left[:, 0], left[:, 1]).tolist())
        limit = self.limits.contradiction_m_s
        if peak > limit:
            _, self.following = drive(self._numbers, self._limits, limit / peak)
