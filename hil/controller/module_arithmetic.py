"""Arithmetic of the module layer for four wheels, on one flat vector.

Between `steer` and `drive` numpy computes the sines and cosines: compiled code may differ in the last bit.
"""

import math
from typing import NamedTuple

from hil.core.geometry import Array, wrap
from hil.support.numba_jit import inner, kernel

inner(wrap)

_QUARTER_RAD = math.pi / 2.0
_FOLLOWING = 0.9

# First index of each part of the vector; four numbers each unless noted, SI units.
ZERO, RADIUS = 0, 4  # steering zeros and radii of the wheels
SPEED, ANGLE = 8, 12  # wheel speeds (not negative) and headings by inverse kinematics
MEASURED, HELD, SENT = 16, 20, 24  # steering angles: measured, target, last set-point on the way there
TURNED = 28  # (12,) from measured to target angle; headings at the measured and at the next angle
NEXT = 40  # steering angles to command
ASKED, GIVEN, RATE = 44, 48, 52  # signed speeds, requested and after limits; wheel rates to command
COSINE, SINE = 56, 68  # cosines (12,) of `TURNED`, sines (8,) of the headings
ROLLED = 76  # (2, 8) wheel vectors at both headings
CONTRADICTING = 92  # (8, 8) projection of wheel vectors on their part that no rigid-body motion explains
SIZE = 156


class ModuleLimits(NamedTuple):
    """Limits of a steered and driven wheel."""

    speed_m_s: float = 0.122
    steering_rad: float = 2.0944
    steering_rate_rad_s: float = 5.0
    still_speed_m_s: float = 0.002
    flip_hysteresis_rad: float = 0.1047
    contradiction_m_s: float = 0.004


@inner
def optimize(
    speed: float, angle_rad: float, measured_rad: float, limits: ModuleLimits
) -> tuple[float, float]:
    """Signed speed and the equivalent angle nearest to the measured one, within the steering range.

    The turn never exceeds a quarter turn plus the hysteresis, unless the steering range forces it.

    Args:
        speed: requested wheel speed, signed, m/s.
        angle_rad: requested steering angle.
        measured_rad: measured steering angle.
        limits: limits of the module.
    """
    near = measured_rad + wrap(angle_rad - measured_rad)
    if abs(near - measured_rad) > _QUARTER_RAD + limits.flip_hysteresis_rad:
        near, speed = near - math.copysign(math.pi, near - measured_rad), -speed
    if abs(near) > limits.steering_rad:
        near, speed = near - math.copysign(math.pi, near), -speed
    return speed, near


@kernel
def steer(n: Array, limits: ModuleLimits, reach_rad: float) -> None:
    """Compute the steering angles to hold and to command next, and the headings that follow from them.

    Args:
        n: (156,) vector; reads `ZERO`, `SPEED`, `ANGLE`, `MEASURED`, `HELD` and `SENT`.
        limits: limits of the modules.
        reach_rad: largest steering step; all modules are slowed alike and arrive together.
    """
    limits, farthest = ModuleLimits(*limits), 0.0
    for i in range(4):
        speed = n[SPEED + i]
        if speed < limits.still_speed_m_s:
            n[ASKED + i] = 0.0
        else:
            wanted = n[ANGLE + i] + n[ZERO + i]
            n[ASKED + i], n[HELD + i] = optimize(speed, wanted, n[MEASURED + i], limits)
        step = abs(n[HELD + i] - n[SENT + i])
        if step > farthest:
            farthest = step
    share, widest = 1.0, limits.steering_rad
    if farthest > reach_rad:
        share = reach_rad / farthest
    for i in range(4):
        angle = n[SENT + i] + (n[HELD + i] - n[SENT + i]) * share
        n[SENT + i] = angle
        if angle > widest:
            angle = widest
        elif angle < -widest:
            angle = -widest
        n[NEXT + i] = angle
        n[TURNED + i] = wrap(n[HELD + i] - n[MEASURED + i])
        n[TURNED + 4 + i] = n[MEASURED + i] - n[ZERO + i]
        n[TURNED + 8 + i] = angle - n[ZERO + i]


@kernel
def drive(n: Array, limits: ModuleLimits, share: float) -> tuple[float, bool]:
    """Compute the wheel rates to command, and the wheel vectors before they were slowed by `share`.

    Args:
        n: (156,) vector; reads `ASKED`, `COSINE`, `SINE`, `RADIUS` and `CONTRADICTING`.
        limits: limits of the modules.
        share: final factor on the speed of all wheels.

    Returns:
        Largest slip of a wheel, m/s, up to rounding, and whether the wheels follow the twist.
    """
    limits = ModuleLimits(*limits)
    fastest, turning, follows = 0.0, False, True
    for i in range(4):
        ahead = n[COSINE + i]
        if not ahead > 0.0:
            ahead = 0.0
        n[GIVEN + i] = n[ASKED + i] * ahead
        if abs(n[GIVEN + i]) > fastest:
            fastest = abs(n[GIVEN + i])
    slowed = 1.0
    if fastest > limits.speed_m_s:
        slowed = limits.speed_m_s / fastest
    for i in range(4):
        speed = n[GIVEN + i] * slowed
        for k in range(0, 8, 4):
            n[ROLLED + 2 * (k + i)] = speed * n[COSINE + 4 + k + i]
            n[ROLLED + 2 * (k + i) + 1] = speed * n[SINE + k + i]
        speed = speed * share
        n[GIVEN + i], n[RATE + i] = speed, speed / n[RADIUS + i]
        if n[ASKED + i] != 0.0:
            turning = True
        if not abs(speed) >= _FOLLOWING * abs(n[ASKED + i]):
            follows = False
    return _slip(n), turning and follows


@inner
def _slip(n: Array) -> float:
    """Largest slip of a wheel, m/s: its residual from the least-squares rigid-body motion."""
    most = 0.0
    for row in range(ROLLED, ROLLED + 16, 8):
        for i in range(CONTRADICTING, CONTRADICTING + 8, 2):
            along, across = 0.0, 0.0
            for k in range(8):
                along += n[row + k] * n[i + 8 * k]
                across += n[row + k] * n[i + 8 * k + 1]
            slip = along * along + across * across
            if not slip <= most:
                most = slip
    return math.sqrt(most)
