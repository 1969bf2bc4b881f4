"""Kalman update of a joint Gaussian, one scalar row after the other, each with its own gate.

The rows' mean, covariance and cross covariance with the state come from a linearisation (EKF) or from sigma
points (UKF) at the predicted state. Conditioning on one row after the other gives exactly the stacked update
and allows a single bad row to be left out. The covariance stays symmetric to the bit, because only outer
products of a vector with itself are subtracted.
"""

import math
from typing import NamedTuple

import numpy as np

from hil.core.geometry import Array
from hil.estimator.matrix_loops import downdate
from hil.estimator.state_vector import ROWS, STATES
from hil.support.numba_jit import inner


class Compared(NamedTuple):
    """Innovations and covariances of a sample's rows, compared with the state.

    Attributes:
        nu: (8,) innovation, measured minus predicted.
        cross: (8, 20) covariance of the predicted rows with the state.
        own: (8, 8) covariance of the predicted rows.
        var: (8,) noise variance; a negative one leaves the row out.
        nis: (8,) filled with normalised innovations squared.
    """

    nu: Array
    cross: Array
    own: Array
    var: Array
    nis: Array


@inner
def joint_nis(rows: Compared, count: int) -> float:
    """Normalised innovation squared of `count` rows together, infinite where they have no covariance.

    The terms of the sum, each row given the rows before it, are written to `nis`; nothing else changes.
    """
    nu, s, var, nis = rows.nu[:count].copy(), rows.own[:count, :count].copy(), rows.var, rows.nis
    total = 0.0
    for i in range(count):
        size = s[i, i] + var[i]
        if not size > 0.0:
            nis[i] = math.inf
            return math.inf
        nis[i] = nu[i] * nu[i] / size
        total += nis[i]
        for j in range(i + 1, count):
            gain = s[i, j] / size
            nu[j] -= gain * nu[i]
            for k in range(i + 1, count):
                s[k, j] -= gain * s[k, i]
    return total


@inner
def condition(x: Array, p: Array, rows: Compared, count: int, gate: float) -> int:
    """Update state and covariance in place, row by row.

    Args:
        x: (20,) state.
        p: (20, 20) covariance.
        rows: innovations and covariances are overwritten; `nis` is set, to -1 where a row was not usable.
        count: number of rows.
        gate: largest normalised innovation squared of one row.

    Returns:
        Number of accepted rows.
    """
    used, n = 0, p.shape[0]
    nu, cross, own, var, nis = rows
    for i in range(count):
        nis[i] = -1.0
        size = own[i, i] + var[i]
        if var[i] >= 0.0 and size > 0.0:
            nis[i] = nu[i] * nu[i] / size
        if not 0.0 <= nis[i] <= gate:
            for j in range(n):
                cross[i, j] = 0.0
            continue
        step, root = nu[i] / size, math.sqrt(size)
        for j in range(n):
            x[j] += cross[i, j] * step
        for j in range(ROWS):
            own[i, j] = np.divide(own[i, j], size)  # no check for zero: size is positive
        for k in range(i + 1, count):
            gain, scale = own[i, k], own[k, i]
            nu[k] -= gain * nu[i]
            for j in range(n):
                cross[k, j] -= gain * cross[i, j]
            for j in range(ROWS):
                own[k, j] -= own[i, j] * scale
        for j in range(n):
            cross[i, j] = np.divide(cross[i, j], root)
        used += 1
    downdate(p, cross, count)
    return used


@inner
def zero_negative_variances(p: Array) -> int:
    """Zero variances of p (n, n) that rounding made negative, and their covariances; return their count."""
    repaired = 0
    for i in range(STATES):
        if p[i, i] < 0.0:
            p[i, :] = 0.0
            p[:, i] = 0.0
            repaired += 1
    return repaired
