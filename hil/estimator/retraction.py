"""How a correction reaches a pose of the state: along the circle that a turned start would have drawn.

A heading that was wrong by an angle has turned all that was driven since about where it began. So what a sample
corrects is applied by the exponential of SE(2) and not number by number, and the covariance of position and
heading, whose lever is the way driven, goes with the pose to where the correction puts it. This is the
invariant extended Kalman filter (Barrau and Bonnabel, 2017) in the coordinates of an ordinary one: for small
corrections both are the same to second order, so that it needs no switch.
"""

from __future__ import annotations

import math

from hil.estimator.process import sinc
from hil.estimator.state import CLONE_X, STATES, X
from hil.vocabulary.geometry import Array
from hil.vocabulary.kernels import compiled

POSES = (X, CLONE_X)
"""Where the poses in the wall frame begin."""


@compiled
def carry(east_m: float, north_m: float, place: int, p: Array) -> None:
    """Covariance of a pose that was moved by so much: an error of its heading has a longer lever."""
    for i in range(STATES):
        turned = p[place + 2, i]
        p[place, i] -= north_m * turned
        p[place + 1, i] += east_m * turned
    for i in range(STATES):
        turned = p[i, place + 2]
        p[i, place] -= north_m * turned
        p[i, place + 1] += east_m * turned
    for i in range(STATES):
        p[place, i] = p[i, place]
        p[place + 1, i] = p[i, place + 1]


@compiled
def retract(before: Array, x: Array, p: Array) -> None:
    """Turn an additive correction of state (20,) and covariance (20, 20) into one along the circle, in place.

    Args:
        before: (20,) the state that was corrected.
        x: the same with the correction added.
        p: conditioned on the rows at `before`.
    """
    for place in POSES:
        turn = x[place + 2] - before[place + 2]
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        k = sinc(0.5 * turn)
        c, s = k * math.cos(0.5 * turn), k * math.sin(0.5 * turn)
        x[place] = before[place] + c * east - s * north
        x[place + 1] = before[place + 1] + s * east + c * north
        carry(x[place] - before[place], x[place + 1] - before[place + 1], place, p)


@compiled
def pull_retraction(before: Array, x: Array, late: Array, spread: Array) -> None:
    """Carry what later samples say back through `carry`; as `hil.estimator.smoother.pull_update`."""
    for place in POSES:
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        late[place + 2] += east * late[place + 1] - north * late[place]
        for i in range(STATES):
            spread[i, place + 2] += east * spread[i, place + 1] - north * spread[i, place]
        for i in range(STATES):
            spread[place + 2, i] += east * spread[place + 1, i] - north * spread[place, i]
