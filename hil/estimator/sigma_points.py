"""Unscented transform without the numerical traps of common filter libraries.

Sigma points are drawn anew before every use. Sums are taken relative to the centre point, because W_0 is
about -1e6 at alpha = 1e-3. Headings are unwrapped real numbers, so there is no circular mean. The square root
accepts a singular covariance: a state that was just cloned has no variance of its own.

With points x +- spread L_k, values f_k+ and f_k-, odd part o_k = (f_k+ - f_k-) / 2 and even part
e_k = (f_k+ + f_k-) / 2 - f_0, the weights collect to

    mean = f_0 + D, D = 2 w sum e_k;  cov(x, f) = 2 w spread sum L_k o_k';
    cov(f) = 2 w sum (o_k o_k' + e_k e_k') + (beta - alpha^2) D D'

in which nothing cancels. The linear part of the model keeps its covariance exactly and needs no points.
"""

import math
from typing import NamedTuple, TypeAlias

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.estimator.constant_twist import advance_linear_states, camera_displacement, wall_shift
from hil.estimator.kernel_layout import Parameters, Work
from hil.estimator.matrix_loops import spread, square_root
from hil.estimator.process_model import add_noise, fade_covariance, mirror
from hil.estimator.sensors import predicted
from hil.estimator.state_vector import CAMERA_X, CAMERA_Y, CURVED, OMEGA, ROWS, SCALE, STATES, X, Y
from hil.support.numba_jit import inner

PLACES = (X, Y, CAMERA_X, CAMERA_Y)
"""States whose prediction is nonlinear."""


class Weights(NamedTuple):
    """Spread and weights of the sigma points.

    Attributes:
        reach: distance of a point from the centre, in columns of the square root.
        pair: 2 w, the weight of two opposite points.
        centre: beta - alpha^2, the weight of the squared offset of the mean.
    """

    reach: float
    pair: float
    centre: float


Points: TypeAlias = Weights | None
"""Sigma points of the UKF; None for the EKF."""


def points_of(config: EstimatorConfig) -> Points:
    """Sigma points of a configuration; None for the EKF."""
    if config.kind != "ukf":
        return None
    total = config.alpha * config.alpha * (STATES + config.kappa)
    return Weights(math.sqrt(total), 1.0 / total, config.beta - config.alpha * config.alpha)


@inner
def parts(high: Array, low: Array, centre: Array, odd: Array, even: Array) -> None:
    """Odd and even parts (8,) of values (8,) at two opposite points and the centre."""
    for i in range(ROWS):
        odd[i] = 0.5 * (high[i] - low[i])
        even[i] = 0.5 * ((high[i] - centre[i]) + (low[i] - centre[i]))


@inner
def collect(w: Weights, root: Array, count: int, work: Work, cross: Array, own: Array) -> None:
    """Sum up the odd and even parts of `count` values: offset of the mean, `cross` and `own`.

    Args:
        w: weights.
        root: (rows, 20) square root of the covariance, as many rows as there are pairs of points.
        count: number of values.
        work: odd and even parts; its `offset` (8,) is filled with the mean's distance from the centre.
        cross: (8, 20) filled with the covariance of values and state.
        own: (8, 8) filled with the covariance of the values.
    """
    offset, odd, even = work.offset, work.odd, work.even
    offset[:] = 0.0
    own[:, :] = 0.0
    for k in range(root.shape[0]):
        for i in range(count):
            o, e = odd[k, i], even[k, i]
            offset[i] += w.pair * e
            for j in range(i + 1):
                own[i, j] += w.pair * (o * odd[k, j] + e * even[k, j])
    for i in range(count):
        for j in range(i + 1):
            own[i, j] += w.centre * offset[i] * offset[j]
            own[j, i] = own[i, j]
    spread(root, odd[:], count, w.reach * w.pair, cross)


@inner
def advance_unscented(x: Array, p: Array, dt_s: float, par: Parameters, w: Weights, nominal: Array) -> None:
    """Unscented prediction of x (20,), p (20, 20), in place; points for the positions only."""
    work, by = par.work, par.process
    root, up, down, high, low = work.root[:CURVED], work.up[:], work.down[:], work.high, work.low
    centre, scale = work.centre, x[SCALE]
    square_root(p, root)
    high[:], low[:], centre[:] = 0.0, 0.0, 0.0
    centre[0], centre[1] = wall_shift(x, dt_s)
    centre[2], centre[3] = camera_displacement(x, dt_s, by.scaled, scale, nominal)
    for k in range(CURVED):
        for i in range(STATES):
            up[i], down[i] = x[i] + w.reach * root[k, i], x[i] - w.reach * root[k, i]
        if k <= OMEGA:  # states after the twist do not affect the pose in the wall frame
            high[0], high[1] = wall_shift(up, dt_s)
            low[0], low[1] = wall_shift(down, dt_s)
        else:
            high[0], high[1] = low[0], low[1] = centre[0], centre[1]
        high[2], high[3] = camera_displacement(up, dt_s, by.scaled, scale, nominal)
        low[2], low[3] = camera_displacement(down, dt_s, by.scaled, scale, nominal)
        parts(high, low, centre, work.odd[k], work.even[k])
        for i in range(4):
            work.odd[k, i] += w.reach * root[k, PLACES[i]]
    collect(w, root, len(PLACES), work, work.cross[:], work.own[:])
    for i in range(4):
        for j in range(STATES):
            p[PLACES[i], j] = work.cross[i, j]
    for i in range(4):
        for j in range(4):
            p[PLACES[i], PLACES[j]] = work.own[i, j]
    mirror(p, PLACES)
    decay = math.exp(-dt_s / by.slip_s)
    fade_covariance(p, dt_s, decay)
    add_noise(x, p, dt_s, by)
    for i in range(4):
        x[PLACES[i]] += centre[i] + work.offset[i]
    advance_linear_states(x, dt_s, decay)


@inner
def moments_unscented(number: int, x: Array, p: Array, par: Parameters, w: Weights, count: int) -> None:
    """`event_loop.moments` by sigma points."""
    work = par.work
    aux, mean, cross, own = work.aux[:], work.mean[:], work.cross[:], work.own[:]
    root, up, down, high, low = work.root[:], work.up[:], work.down[:], work.high[:], work.low[:]
    square_root(p, root)
    high[:], low[:] = 0.0, 0.0
    predicted(number, x, aux, par, mean)
    for k in range(STATES):
        for i in range(STATES):
            up[i], down[i] = x[i] + w.reach * root[k, i], x[i] - w.reach * root[k, i]
        predicted(number, up, aux, par, high)
        predicted(number, down, aux, par, low)
        parts(high, low, mean, work.odd[k], work.even[k])
    collect(w, root, count, work, cross, own)
    for i in range(count):
        mean[i] += work.offset[i]
