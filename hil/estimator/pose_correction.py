"""How a correction reaches a pose of the state: along the circle that a turned start would have drawn.

A heading that was wrong by an angle has turned all that was driven since about where it began. So what a
sample corrects is applied by the exponential of SE(2), not number by number, and the covariance of position
and heading, whose lever is the way driven, goes with the pose to where the correction puts it. This is the
invariant extended Kalman filter (Barrau and Bonnabel, 2017) in the coordinates of an ordinary one: for small
corrections both are the same to second order, so that it needs no switch. Where the heading is known to
`UNSURE_RAD` only, `settle` looks for the point to linearise at before anything is gated.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.geometry import Array
from hil.estimator.constant_twist import sinc
from hil.estimator.kalman_update import Compared, condition
from hil.estimator.kernel_layout import Parameters
from hil.estimator.matrix_loops import check_size, put, put_rows, seen
from hil.estimator.sensors import GATED_TOGETHER, innovation, jacobian, predicted
from hil.estimator.state_vector import CLONE_X, OMEGA, ROWS, STATES, THETA, X
from hil.support.numba_jit import inner

POSES = (X, CLONE_X)
"""Where the poses in the wall frame begin."""
UNSURE_RAD = 0.05
LOST_RAD = 0.07
"""Up to it a UKF by points is consistent: NEES 2.8 after a metre and positions, with 0.08 rad 6.8."""
_TURNS = 8


@inner
def is_unsure(number: int, p: Array) -> bool:
    """Whether a pose meets a heading, covariance p (20, 20), too unsure for one linearisation."""
    return GATED_TOGETHER[number] and p[THETA, THETA] > UNSURE_RAD * UNSURE_RAD


@inner
def is_lost(p: Array, dt_s: float) -> bool:
    """Whether a heading, covariance p (20, 20), is known to `LOST_RAD` or worse, or will be after `dt_s`.

    Then the UKF goes as the EKF does. Sigma points give the mean over all headings: the robot goes less far
    by sigma^2 / 2, and beyond 1.4 rad backwards; the true mean cosine, exp(-sigma^2 / 2), is never negative.
    """
    turned = dt_s * (2.0 * p[THETA, OMEGA] + dt_s * p[OMEGA, OMEGA])
    return bool(p[THETA, THETA] + turned >= LOST_RAD * LOST_RAD)


@inner
def lean(before: Array, point: Array, v: Array, way: float) -> None:
    """Correction (20,) at `before` as one at `point` (way 1), or back (way -1), in place."""
    for place in POSES:
        v[place] -= way * (point[place + 1] - before[place + 1]) * v[place + 2]
        v[place + 1] += way * (point[place] - before[place]) * v[place + 2]


@inner
def follow(before: Array, x: Array) -> None:
    """Turn `before` (20,) with a correction added into one corrected along the circle, x (20,), in place."""
    for place in POSES:
        turn = x[place + 2] - before[place + 2]
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        k = sinc(0.5 * turn)
        c, s = k * math.cos(0.5 * turn), k * math.sin(0.5 * turn)
        x[place] = before[place] + c * east - s * north
        x[place + 1] = before[place + 1] + s * east + c * north


@inner
def carry(before: Array, x: Array, p: Array) -> None:
    """Covariance (20, 20) at `before` as one at x: errors of a heading have another lever there; in place."""
    check_size(p)
    for place in POSES:
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        for i in range(STATES):
            turned = p[place + 2, i]
            p[place, i] -= north * turned
            p[place + 1, i] += east * turned
        for i in (place, place + 1):
            turned = p[i, place + 2]
            p[i, place] -= north * turned
            p[i, place + 1] += east * turned
        p[place + 1, place] = p[place, place + 1]
        for i in range(STATES):
            p[i, place], p[i, place + 1] = p[place, i], p[place + 1, i]


@inner
def pull_carry(before: Array, x: Array, late: Array, spread: Array) -> None:
    """Carry what later samples say, late (20,), spread (20, 20), back through `carry`, as `pull_update`."""
    for place in POSES:
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        late[place + 2] += east * late[place + 1] - north * late[place]
        for i in range(STATES):
            spread[i, place + 2] += east * spread[i, place + 1] - north * spread[i, place]
        for i in range(STATES):
            spread[place + 2, i] += east * spread[place + 1, i] - north * spread[place, i]


@inner
def settle(number: int, x: Array, p: Array, count: int, par: Parameters, point: Array, spread: Array) -> None:
    """The point that a sample's rows draw the state to, by Gauss and Newton, and the rows linearised there.

    Args:
        number: of the sensor.
        x: (20,) state.
        p: (20, 20) its covariance.
        count: number of rows.
        par: of all kernels; `observe` has filled `z`, `var` and `aux` of its `work`. There, `nu` is filled
            with the innovations less what the way from x to the point explains; `cross`, `own` and `h` with
            covariances and derivative of the rows at the point.
        point: (20,) filled, and
        spread: (20, 20) with the covariance `p` at it.
    """
    w = par.work
    z, var, aux, nu = w.z[:], w.var[:], w.aux[:], w.nu[:]
    cross, own, h = w.cross[:], w.own[:], w.h[:]
    toward, mean, ignored = np.zeros(STATES), np.zeros(ROWS), np.zeros(ROWS)
    for _ in range(_TURNS):
        put(point, x + toward)
        follow(x, point)
        put_rows(spread, p)
        carry(x, point, spread)
        h[:, :] = 0.0
        predicted(number, point, aux, par, mean)
        jacobian(number, point, aux, par, h)
        seen(spread, h, count, cross, own)
        lean(x, point, toward, 1.0)
        innovation(number, z, mean, var, count, nu)
        nu += h @ toward
        toward[:] = 0.0
        rows = Compared(nu.copy(), cross.copy(), own.copy(), var, ignored)
        condition(toward, spread.copy(), rows, count, math.inf)
        lean(x, point, toward, -1.0)
