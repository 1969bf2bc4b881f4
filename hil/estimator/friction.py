"""Dry-friction body displacement of four wheels over a short window, for the filter kernels.

The wheels' disagreement is smaller than the encoder's quantisation in one servo step, so the friction
weights come from the steps of the last `friction_window_s` together and are applied to the newest step
(`facts/calibration.md` section 3: block of 0.3 s, continuation q = 2, 1.5, 1.2, 1). Same law as
`hil.kinematics.least_dissipation`.
"""

from __future__ import annotations

import math

import numpy as np

from hil.estimator.compiled import compiled
from hil.geometry import Array
from hil.kinematics import FRICTION_EPSILON

_POWERS = np.array([2.0, 1.5, 1.5, 1.5, 1.2, 1.2, 1.2, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])


@compiled
def weighted_twist(u: Array, weight: Array, wheels: Array) -> Array:
    """Body displacement (3,) that fits wheel vectors (8,) with one weight (4,) per wheel."""
    total, sx, sy, srr = 0.0, 0.0, 0.0, 0.0
    bx, by, bt = 0.0, 0.0, 0.0
    for i in range(4):
        w, px, py = weight[i], wheels[2, i], wheels[3, i]
        total += w
        sx += w * px
        sy += w * py
        srr += w * (px * px + py * py)
        bx += w * u[2 * i]
        by += w * u[2 * i + 1]
        bt += w * (px * u[2 * i + 1] - py * u[2 * i])
    turn = (bt - (sx * by - sy * bx) / total) / (srr - (sx * sx + sy * sy) / total)
    return np.array([(bx + sy * turn) / total, (by - sx * turn) / total, turn])


@compiled
def friction_weights(u: Array, wheels: Array) -> Array:
    """Weight (4,) of each contact at the least-dissipation displacement of wheel vectors (8,)."""
    weight = np.ones(4)
    scale = 1e-9
    for i in range(4):
        scale += 0.25 * math.sqrt(u[2 * i] * u[2 * i] + u[2 * i + 1] * u[2 * i + 1])
    for power in _POWERS:
        b = weighted_twist(u, weight, wheels)
        for i in range(4):
            ex = b[0] - wheels[3, i] * b[2] - u[2 * i]
            ey = b[1] + wheels[2, i] * b[2] - u[2 * i + 1]
            size = math.sqrt(ex * ex + ey * ey) / scale + FRICTION_EPSILON
            weight[i] = math.exp((power - 2.0) * math.log(size))
    return weight


@compiled
def friction_twist(u: Array, window: Array, wheels: Array) -> Array:
    """Displacement (3,) of the newest step (8,), weighted by the friction over the window's sum (8,)."""
    still = 0.0
    for i in range(8):
        still += abs(window[i])
    if still < 1e-4:
        return weighted_twist(u, np.ones(4), wheels)
    return weighted_twist(u, friction_weights(window, wheels), wheels)
