"""Applies a correction to a pose of the state along a circular arc, as in an invariant Kalman filter.

An error of the heading has rotated all of the path driven since it arose. So a correction is applied by the
exponential of SE(2), not component by component. The covariance of position and heading, whose lever is the
distance driven, is moved to the corrected pose. This is the invariant extended Kalman filter (Barrau and
Bonnabel, 2017) in the coordinates of an ordinary one. For small corrections both agree to second order, so no
switch between them is needed. Where the heading is known only to `UNSURE_RAD`, `find_linearisation_point`
finds the point to linearise at before any row is gated.
"""

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
"""First index of each pose in the wall frame."""
UNSURE_RAD = 0.05
LOST_RAD = 0.07
"""Up to this a UKF with sigma points is consistent: NEES 2.8 after 1 m with positions; at 0.08 rad 6.8."""
_TURNS = 8


@inner
def is_unsure(number: int, p: Array) -> bool:
    """Whether the sensor measures a pose while the heading, p (20, 20), is too unsure to linearise once."""
    return GATED_TOGETHER[number] and p[THETA, THETA] > UNSURE_RAD * UNSURE_RAD


@inner
def is_lost(p: Array, dt_s: float) -> bool:
    """Whether the heading's standard deviation, p (20, 20), is `LOST_RAD` or more now or after `dt_s`.

    The UKF then predicts and updates as the EKF does. Sigma points average over all headings: the robot would
    travel less far by sigma^2 / 2, and beyond 1.4 rad backwards. The true mean cosine, exp(-sigma^2 / 2), is
    never negative.
    """
    turned = dt_s * (2.0 * p[THETA, OMEGA] + dt_s * p[OMEGA, OMEGA])
    return bool(p[THETA, THETA] + turned >= LOST_RAD * LOST_RAD)


@inner
def transport_correction(before: Array, point: Array, v: Array, way: float) -> None:
    """Transform a correction v (20,) from `before` to `point` (way 1) or back (way -1), in place."""
    for place in POSES:
        v[place] -= way * (point[place + 1] - before[place + 1]) * v[place + 2]
        v[place + 1] += way * (point[place] - before[place]) * v[place + 2]


@inner
def correct_along_arc(before: Array, x: Array) -> None:
    """Replace the correction added to `before` (20,), giving x (20,), by one along the arc; x in place."""
    for place in POSES:
        turn = x[place + 2] - before[place + 2]
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        k = sinc(0.5 * turn)
        c, s = k * math.cos(0.5 * turn), k * math.sin(0.5 * turn)
        x[place] = before[place] + c * east - s * north
        x[place + 1] = before[place + 1] + s * east + c * north


@inner
def transport_covariance(before: Array, x: Array, p: Array) -> None:
    """Move the covariance (20, 20) from `before` to x, in place; heading errors have another lever there."""
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
    """Carry the later samples' late (20,), spread (20, 20) back through `transport_covariance`.

    See `hil.estimator.smoother.pull_update`.
    """
    for place in POSES:
        east, north = x[place] - before[place], x[place + 1] - before[place + 1]
        late[place + 2] += east * late[place + 1] - north * late[place]
        for i in range(STATES):
            spread[i, place + 2] += east * spread[i, place + 1] - north * spread[i, place]
        for i in range(STATES):
            spread[place + 2, i] += east * spread[place + 1, i] - north * spread[place, i]


@inner
def find_linearisation_point(
    number: int, x: Array, p: Array, count: int, par: Parameters, point: Array, spread: Array
) -> None:
    """Find the point to linearise at, by Gauss-Newton iterations, and linearise the sample's rows there.

    Args:
        number: sensor number.
        x: (20,) state.
        p: (20, 20) its covariance.
        count: number of rows.
        par: parameters of all kernels. `observe` has filled `z`, `var` and `aux` of `par.work`. This fills
            `nu` with the innovations less what the step from x to the point explains, and `cross`, `own` and
            `h` with covariances and derivative of the rows at the point.
        point: (20,) filled with the point.
        spread: (20, 20) filled with the covariance `p` moved to the point.
    """
    w = par.work
    z, var, aux, nu = w.z[:], w.var[:], w.aux[:], w.nu[:]
    cross, own, h = w.cross[:], w.own[:], w.h[:]
    toward, mean, ignored = np.zeros(STATES), np.zeros(ROWS), np.zeros(ROWS)
    for _ in range(_TURNS):
        put(point, x + toward)
        correct_along_arc(x, point)
        put_rows(spread, p)
        transport_covariance(x, point, spread)
        h[:, :] = 0.0
        predicted(number, point, aux, par, mean)
        jacobian(number, point, aux, par, h)
        seen(spread, h, count, cross, own)
        transport_correction(x, point, toward, 1.0)
        innovation(number, z, mean, var, count, nu)
        nu += h @ toward
        toward[:] = 0.0
        rows = Compared(nu.copy(), cross.copy(), own.copy(), var, ignored)
        condition(toward, spread.copy(), rows, count, math.inf)
        transport_correction(x, point, toward, -1.0)
