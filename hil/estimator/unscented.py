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

import numpy as np

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.process import add_noise, sinc
from hil.estimator.sensors import predicted
from hil.estimator.small_matrices import spread, square_root
from hil.vocabulary.geometry import Array

_MOVING = 6
"""Leading states that the new position depends on: later columns of the root leave them alone."""


@compiled
def weights(n: int, alpha: float, beta: float, kappa: float) -> Array:
    """Spread of the points, 2 w, and beta - alpha^2."""
    total = alpha * alpha * (n + kappa)
    return np.array([math.sqrt(total), 1.0 / total, beta - alpha * alpha])


@compiled
def moved_position(x: Array, dt_s: float, out: Array) -> None:
    """Position (2,) of a state after `dt_s`, as `process.move` does it: the only nonlinear part."""
    h = 0.5 * x[5] * dt_s
    k = sinc(h) * dt_s
    c, s = math.cos(x[2] + h), math.sin(x[2] + h)
    out[0] = x[0] + k * (c * x[3] - s * x[4])
    out[1] = x[1] + k * (s * x[3] + c * x[4])


@compiled
def parts(high: Array, low: Array, centre: Array, k: int, count: int, odd: Array, even: Array) -> None:
    """Row k of the odd and even parts of values at two opposite points."""
    for i in range(count):
        odd[k, i] = 0.5 * (high[i] - low[i])
        even[k, i] = 0.5 * ((high[i] - centre[i]) + (low[i] - centre[i]))


@compiled
def collect(
    w: Array, root: Array, odd: Array, even: Array, count: int, offset: Array, cross: Array, own: Array
) -> None:
    """Offset of the mean (8,), covariance with the state (20, 8) and of the values (8, 8), zeroed before."""
    n = root.shape[0]
    for k in range(n):
        for i in range(count):
            offset[i] += w[1] * even[k, i]
            for j in range(i + 1):
                own[i, j] += w[1] * (odd[k, i] * odd[k, j] + even[k, i] * even[k, j])
    for i in range(count):
        for j in range(i + 1):
            own[i, j] += w[2] * offset[i] * offset[j]
            own[j, i] = own[i, j]
    spread(root, odd, count, w[0] * w[1], cross)


@compiled
def advance_unscented(x: Array, p: Array, dt_s: float, par: Array) -> None:
    """Unscented prediction, in place: points for the position, the rest of the model is linear."""
    n = L.STATES
    w = weights(n, par[L.ALPHA], par[L.BETA], par[L.KAPPA])
    root = square_root(p, _MOVING)
    odd, even = np.zeros((n, L.ROWS)), np.zeros((n, L.ROWS))
    centre, high, low = np.zeros(2), np.zeros(2), np.zeros(2)
    up, down = np.zeros(_MOVING), np.zeros(_MOVING)
    moved_position(x, dt_s, centre)
    for k in range(_MOVING):
        for i in range(_MOVING):
            up[i], down[i] = x[i] + w[0] * root[i, k], x[i] - w[0] * root[i, k]
        moved_position(up, dt_s, high)
        moved_position(down, dt_s, low)
        parts(high, low, centre, k, 2, odd, even)
    offset, cross, own = np.zeros(L.ROWS), np.zeros((n, L.ROWS)), np.zeros((L.ROWS, L.ROWS))
    collect(w, root, odd, even, 2, offset, cross, own)
    start = x.copy()
    x[0], x[1] = centre[0] + offset[0], centre[1] + offset[1]
    x[2] += x[5] * dt_s
    decay = math.exp(-dt_s / par[L.SLIP_S])
    x[8] *= decay
    x[9] *= decay
    for i in range(2):
        for j in range(n):
            p[i, j] = p[j, i] = cross[j, i]
    for i in range(2):
        for j in range(2):
            p[i, j] = own[i, j]
    for _ in range(2):
        p[2] += dt_s * p[5]
        p[8] *= decay
        p[9] *= decay
        transpose(p)
    add_noise(start, p, dt_s, par)


@compiled
def transpose(p: Array) -> None:
    """Transpose in place."""
    n = p.shape[0]
    for i in range(n):
        for j in range(i):
            p[i, j], p[j, i] = p[j, i], p[i, j]


@compiled
def moments_unscented(
    kind: int, x: Array, p: Array, aux: Array, par: Array, rows: Array, count: int,
    mean: Array, cross: Array, own: Array,
) -> None:  # fmt: skip
    """Mean (count,), cross covariance (20, count) with the state and covariance of predicted rows."""
    n = L.STATES
    w = weights(n, par[L.ALPHA], par[L.BETA], par[L.KAPPA])
    root = square_root(p, n)
    odd, even = np.zeros((n, L.ROWS)), np.zeros((n, L.ROWS))
    high, low, offset = np.zeros(L.ROWS), np.zeros(L.ROWS), np.zeros(L.ROWS)
    predicted(kind, x, aux, par, rows, mean)
    up, down = x.copy(), x.copy()
    for k in range(n):
        for i in range(n):
            up[i], down[i] = x[i] + w[0] * root[i, k], x[i] - w[0] * root[i, k]
        predicted(kind, up, aux, par, rows, high)
        predicted(kind, down, aux, par, rows, low)
        parts(high, low, mean, k, count, odd, even)
    collect(w, root, odd, even, count, offset, cross, own)
    for i in range(count):
        mean[i] += offset[i]
