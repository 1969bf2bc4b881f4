"""Unscented transform with its known traps avoided: those that filter libraries fall into.

Sigma points are drawn anew before every use; sums are taken relative to the centre point, because
W_0 is about -1e6 at alpha = 1e-3; headings are unwrapped real numbers, so there is no circular mean. The
square root accepts a singular covariance: a state that was just cloned has no variance of its own.

With points x +- spread L_k, values f_k+ and f_k-, odd part o_k = (f_k+ - f_k-) / 2 and even part
e_k = (f_k+ + f_k-) / 2 - f_0, the weights collect to

    mean = f_0 + D, D = 2 w sum e_k;  cov(x, f) = 2 w spread sum L_k o_k';
    cov(f) = 2 w sum (o_k o_k' + e_k e_k') + (beta - alpha^2) D D'

in which nothing cancels. What the model leaves linear keeps its covariance exactly and needs no points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.estimator.layout import FilterParameters, Parameters
from hil.estimator.process import ProcessParameters, add_noise, fade, shifts
from hil.estimator.sensors import predicted
from hil.estimator.small_matrices import spread, square_root
from hil.estimator.state import (
    CURVED,
    OMEGA,
    ROWS,
    SCALE,
    SIGHT_THETA,
    SIGHT_X,
    SLIP_X,
    SLIP_Y,
    STATES,
    THETA,
    X,
)
from hil.vocabulary.geometry import Array
from hil.vocabulary.kernels import compiled


class Weights(NamedTuple):
    """How sigma points are spread and added up.

    Attributes:
        reach: how many columns of the root a point lies from the centre.
        pair: 2 w, the weight of two opposite points.
        centre: beta - alpha^2, for the square of the mean's offset.
    """

    reach: float
    pair: float
    centre: float


@compiled
def weights(n: int, points: FilterParameters) -> Weights:
    """Weights for `n` states."""
    total = points.alpha * points.alpha * (n + points.kappa)
    return Weights(math.sqrt(total), 1.0 / total, points.beta - points.alpha * points.alpha)


@compiled
def parts(high: Array, low: Array, centre: Array, k: int, count: int, odd: Array, even: Array) -> None:
    """Row k of the odd and even parts (n, 8) of values (8,) at two opposite points and the centre."""
    for i in range(count):
        odd[k, i] = 0.5 * (high[i] - low[i])
        even[k, i] = 0.5 * ((high[i] - centre[i]) + (low[i] - centre[i]))


@compiled
def collect(
    w: Weights, root: Array, odd: Array, even: Array, count: int, offset: Array, cross: Array, own: Array
) -> None:
    """Offset of the mean (8,), covariance with the state (20, 8) and of the values (8, 8), zeroed before."""
    n = root.shape[0]
    for k in range(n):
        for i in range(count):
            offset[i] += w.pair * even[k, i]
            for j in range(i + 1):
                own[i, j] += w.pair * (odd[k, i] * odd[k, j] + even[k, i] * even[k, j])
    for i in range(count):
        for j in range(i + 1):
            own[i, j] += w.centre * offset[i] * offset[j]
            own[j, i] = own[i, j]
    spread(root, odd, count, w.reach * w.pair, cross)


@compiled
def transpose(p: Array) -> None:
    """Transpose (n, n) in place."""
    n = p.shape[0]
    for i in range(n):
        for j in range(i):
            p[i, j], p[j, i] = p[j, i], p[i, j]


@compiled
def advance_unscented(
    x: Array, p: Array, dt_s: float, points: FilterParameters, par: ProcessParameters, nominal: Array
) -> None:
    """Unscented prediction of x (20,), p (20, 20), in place: points for the position, the rest is linear."""
    n = STATES
    w = weights(n, points)
    root = square_root(p, CURVED)
    odd, even = np.zeros((n, ROWS)), np.zeros((n, ROWS))
    centre, high, low, places = np.zeros(4), np.zeros(4), np.zeros(4), (X, X + 1, SIGHT_X, SIGHT_X + 1)
    up, down = np.zeros(CURVED), np.zeros(CURVED)
    shifts(x, dt_s, par.scaled, x[SCALE], nominal, centre)
    for k in range(CURVED):
        for i in range(CURVED):
            up[i], down[i] = x[i] + w.reach * root[i, k], x[i] - w.reach * root[i, k]
        shifts(up, dt_s, par.scaled, x[SCALE], nominal, high)
        shifts(down, dt_s, par.scaled, x[SCALE], nominal, low)
        parts(high, low, centre, k, 4, odd, even)
        for i in range(4):
            odd[k, i] += w.reach * root[places[i], k]
    offset, cross, own = np.zeros(ROWS), np.zeros((n, ROWS)), np.zeros((ROWS, ROWS))
    collect(w, root, odd, even, 4, offset, cross, own)
    start = x.copy()
    for i in range(4):
        x[places[i]] += centre[i] + offset[i]
    fade(x, dt_s, par.slip_s)
    decay = math.exp(-dt_s / par.slip_s)
    for i in range(4):
        for j in range(n):
            p[places[i], j] = p[j, places[i]] = cross[j, i]
    for i in range(4):
        for j in range(4):
            p[places[i], places[j]] = own[i, j]
    for _ in range(2):
        p[THETA] += dt_s * p[OMEGA]
        p[SIGHT_THETA] += dt_s * p[OMEGA]
        p[SLIP_X] *= decay
        p[SLIP_Y] *= decay
        transpose(p)
    for i in range(n):
        for j in range(i):
            p[i, j] = p[j, i]
    add_noise(start, p, dt_s, par)


@compiled
def moments_unscented(
    number: int, x: Array, p: Array, aux: Array, par: Parameters, count: int,
    mean: Array, cross: Array, own: Array,
) -> None:  # fmt: skip
    """Mean (8,), covariance with the state (20, 8) and covariance (8, 8) of rows, as `events.moments`."""
    n = STATES
    w = weights(n, par.filter)
    root = square_root(p, n)
    odd, even = np.zeros((n, ROWS)), np.zeros((n, ROWS))
    high, low, offset = np.zeros(ROWS), np.zeros(ROWS), np.zeros(ROWS)
    predicted(number, x, aux, par, mean)
    up, down = x.copy(), x.copy()
    for k in range(n):
        for i in range(n):
            up[i], down[i] = x[i] + w.reach * root[i, k], x[i] - w.reach * root[i, k]
        predicted(number, up, aux, par, high)
        predicted(number, down, aux, par, low)
        parts(high, low, mean, k, count, odd, even)
    collect(w, root, odd, even, count, offset, cross, own)
    for i in range(count):
        mean[i] += offset[i]
