"""Unscented transform with its known traps avoided (`facts/estimation.md`, traps in the libraries).

Sigma points are drawn anew before every use; sums are taken relative to the centre point, because
W_0 is about -1e6 at alpha = 1e-3; headings are unwrapped real numbers, so there is no circular mean. The
square root accepts a singular covariance: a state that was just cloned has no variance of its own.
"""

from __future__ import annotations

import math

import numpy as np

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.process import add_noise, move
from hil.estimator.sensors import predicted
from hil.geometry import Array

_ZERO_PIVOT = 1e-14


@compiled
def square_root(p: Array) -> Array:
    """Lower triangular L with L L' = P for a positive semi-definite P; a zero pivot leaves a zero column."""
    n = p.shape[0]
    out = np.zeros((n, n))
    for j in range(n):
        pivot = p[j, j] - np.dot(out[j, :j], out[j, :j])
        if pivot <= _ZERO_PIVOT * p[j, j] or pivot <= 0.0:
            continue
        root = math.sqrt(pivot)
        out[j, j] = root
        for i in range(j + 1, n):
            out[i, j] = (p[i, j] - np.dot(out[i, :j], out[j, :j])) / root
    return out


@compiled
def sigma_points(x: Array, p: Array, spread: float) -> Array:
    """Points (2 n + 1, n): the centre, then centre plus and minus `spread` times each column of the root."""
    n = x.shape[0]
    root = square_root(p) * spread
    out = np.empty((2 * n + 1, n))
    out[0] = x
    for i in range(n):
        out[1 + i] = x + root[:, i]
        out[1 + n + i] = x - root[:, i]
    return out


@compiled
def weights(n: int, alpha: float, beta: float, kappa: float) -> Array:
    """Spread, weight of a point off the centre, weight of the mean's offset in the covariance.

    With d_i = f_i - f_0 and D = w sum d_i, the covariance is w sum (d_i - D)(d_i - D)' + w_0 D D'.
    """
    total = alpha * alpha * (n + kappa)
    return np.array([math.sqrt(total), 0.5 / total, 1.0 - n / total + 1.0 - alpha * alpha + beta])


@compiled
def advance_unscented(x: Array, p: Array, dt_s: float, par: Array) -> None:
    """Unscented prediction, in place."""
    n = L.STATES
    w = weights(n, par[L.ALPHA], par[L.BETA], par[L.KAPPA])
    points = sigma_points(x, p, w[0])
    start = x.copy()
    for i in range(2 * n + 1):
        move(points[i], dt_s, par[L.SLIP_S])
    deviation = points[1:] - points[0]
    offset = np.zeros(n)
    for i in range(2 * n):
        offset += w[1] * deviation[i]
    for i in range(2 * n):
        deviation[i] -= offset
    spread = w[1] * (deviation.T @ deviation)
    x[:] = points[0] + offset
    for i in range(n):
        for j in range(i + 1):
            p[i, j] = p[j, i] = 0.5 * (spread[i, j] + spread[j, i]) + w[2] * offset[i] * offset[j]
    add_noise(start, p, dt_s, par)


@compiled
def moments_unscented(
    kind: int, x: Array, p: Array, aux: Array, par: Array, rows: Array, count: int,
    mean: Array, cross: Array, own: Array,
) -> None:  # fmt: skip
    """Mean (count,), cross covariance (20, count) with the state and covariance of predicted rows."""
    n = L.STATES
    w = weights(n, par[L.ALPHA], par[L.BETA], par[L.KAPPA])
    points = sigma_points(x, p, w[0])
    seen = np.zeros((2 * n + 1, L.ROWS))
    for i in range(2 * n + 1):
        predicted(kind, points[i], aux, par, rows, seen[i])
    deviation = seen[1:, :count] - seen[0, :count]
    offset = np.zeros(count)
    for i in range(2 * n):
        offset += w[1] * deviation[i]
    for i in range(2 * n):
        deviation[i] -= offset
    away = points[1:] - points[0]
    cross[:, :count] = w[1] * (away.T @ deviation)
    own[:count, :count] = w[1] * (deviation.T @ deviation)
    for i in range(count):
        mean[i] = seen[0, i] + offset[i]
        for j in range(count):
            own[i, j] += w[2] * offset[i] * offset[j]
