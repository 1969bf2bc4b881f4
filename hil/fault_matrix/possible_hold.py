"""Whether a robot can be held at all against propellers that push by another force than was asked.

Fan and propellers need time, and so does every sensor. A slide is seen once it is larger than a camera's
noise; from then on the best that any bench can do is to press with the fan and to change the throttle. This
module computes that by the equation of motion, apart from bench and emulated worlds.
"""

import math

SEEN_M, ACTS_S = 0.005, 0.05
"""Slide that is certain, five times the noise of a camera; time of exposure, transfer and two looks."""
LOST_M = 0.05
"""Slide after which a robot has fallen in the emulated worlds."""
_SURE = 0.6
"""Share of that slide up to which this model is sure of the outcome."""
_STEP_S, _LAG_S, _LONGEST_S = 0.001, 0.1, 5.0
_FAN_WAITS_S, _FAN_RISES_N_S = 0.07, 20.0
_LESS, _GRAVITY_M_S2 = 0.61, 9.81
"""Share of the set-point to which propellers are lowered that push too much."""


def slides_m(
    share: float,
    *,
    mass_kg: float = 3.25,
    friction: float = 0.45,
    push_n: float = 22.3,
    full_n: float = 39.7,
    fan_n: float = 45.0,
    highest_n: float = 60.0,
    watched: bool = True,
) -> float:
    """Return how far a robot slides, m, before the best response holds it; beyond `LOST_M` it is lost.

    Args:
        share: true push of the propellers over the one that is asked; it begins suddenly.
        mass_kg: mass of the robot.
        friction: coefficient of tyre on wall.
        push_n: set-point of the propellers.
        full_n: highest force of the propellers.
        fan_n: force of the fan.
        highest_n: highest force of the fan.
        watched: True if a bench is open; without one nothing changes.
    """
    weight_n, aim_n, true_n = mass_kg * _GRAVITY_M_S2, share * push_n, push_n
    best = share * (_LESS if share > 1.0 else full_n / push_n) * push_n
    speed_m_s = slid_m = t_s = 0.0
    acts_s = math.inf
    while t_s < _LONGEST_S and slid_m <= LOST_M:
        since_s = t_s - acts_s
        true_n += ((best if since_s > 0.0 else aim_n) - true_n) * _STEP_S / _LAG_S
        pressed_n = min(highest_n, fan_n + max(0.0, _FAN_RISES_N_S * (since_s - _FAN_WAITS_S)))
        free_n, held_n = true_n - weight_n, friction * pressed_n
        if speed_m_s or abs(free_n) > held_n:
            against_n = math.copysign(held_n, speed_m_s or free_n)
            after_m_s = speed_m_s + (free_n - against_n) / mass_kg * _STEP_S
            speed_m_s = 0.0 if speed_m_s * after_m_s < 0.0 else after_m_s
            slid_m += abs(speed_m_s) * _STEP_S
        if watched and slid_m > SEEN_M and math.isinf(acts_s):
            acts_s = t_s + ACTS_S
        t_s += _STEP_S
    return slid_m


def can_be_held(share: float, *, watched: bool = True) -> bool:
    """Return whether the shipped robot can surely be held against propellers that push by this share."""
    return slides_m(share, watched=watched) <= _SURE * LOST_M
