"""The four matrix operations that cost the most, each in two forms of one arithmetic.

`p` (n, n) is a covariance, `root` (n,) or (n, n) what its square root is made of, `h` (8, n) a derivative,
`odd` (n, 8) odd parts, `cross` (n, 8) and `own` (8, 8) covariances of rows.

Loops are quickest when compiled: a library call or a temporary array costs more than the work on a 20x20
matrix. Array expressions are quickest when interpreted. Tests hold both forms against each other.
"""

from __future__ import annotations

import math

import numpy as np

from hil.vocabulary.geometry import Array
from hil.vocabulary.kernels import AVAILABLE, compiled

_ZERO_PIVOT = 1e-14


def downdate_loops(p: Array, root: Array) -> None:
    """Subtract root root' from p (n, n), in place."""
    n = p.shape[0]
    for i in range(n):
        scale = root[i]
        for j in range(n):
            p[i, j] -= scale * root[j]


def downdate_arrays(p: Array, root: Array) -> None:
    """As `downdate_loops`."""
    p -= np.outer(root, root)


def square_root_loops(p: Array, columns: int) -> Array:
    """First columns of the lower triangular L with L L' = P, P (n, n) positive semi-definite.

    A zero pivot leaves a zero column. Column k has no entry above row k.
    """
    n = p.shape[0]
    rest, out, column = p.copy(), np.zeros((n, n)), np.zeros(n)
    for j in range(columns):
        pivot = rest[j, j]
        if pivot <= _ZERO_PIVOT * p[j, j] or pivot <= 0.0:
            continue
        root = math.sqrt(pivot)
        out[j, j] = root
        for i in range(j + 1, n):
            column[i] = rest[i, j] / root
            out[i, j] = column[i]
        for i in range(j + 1, n):
            scale = column[i]
            for k in range(j + 1, i + 1):
                rest[i, k] -= scale * column[k]
    return out


def square_root_arrays(p: Array, columns: int) -> Array:
    """As `square_root_loops`, (n, n) from (n, n)."""
    n = p.shape[0]
    rest, out = p.copy(), np.zeros((n, n))
    for j in range(columns):
        pivot = rest[j, j]
        if pivot <= _ZERO_PIVOT * p[j, j] or pivot <= 0.0:
            continue
        out[j, j] = math.sqrt(pivot)
        out[j + 1 :, j] = rest[j + 1 :, j] / out[j, j]
        rest[j + 1 :, j + 1 :] -= np.outer(out[j + 1 :, j], out[j + 1 :, j])
    return out


def seen_loops(p: Array, h: Array, count: int, cross: Array, own: Array) -> None:
    """Covariance of the state with rows h (8, n): cross (n, 8) = P h', own (8, 8) = h P h'; `count` rows."""
    n = p.shape[0]
    for i in range(count):
        for k in range(n):
            slope = h[i, k]
            if slope != 0.0:
                for j in range(n):
                    cross[j, i] += slope * p[k, j]
    for i in range(count):
        for j in range(count):
            total = 0.0
            for k in range(n):
                if h[j, k] != 0.0:
                    total += h[j, k] * cross[k, i]
            own[j, i] = total


def seen_arrays(p: Array, h: Array, count: int, cross: Array, own: Array) -> None:
    """As `seen_loops`."""
    cross[:, :count] = p @ h[:count].T
    own[:count, :count] = h[:count] @ cross[:, :count]


def spread_loops(root: Array, odd: Array, count: int, weight: float, cross: Array) -> None:
    """Cross (n, 8) = weight L odd for `count` columns: L (n, n) lower triangular, odd (n, 8)."""
    n = root.shape[0]
    for j in range(n):
        for k in range(j + 1):
            scale = weight * root[j, k]
            if scale != 0.0:
                for i in range(count):
                    cross[j, i] += scale * odd[k, i]


def spread_arrays(root: Array, odd: Array, count: int, weight: float, cross: Array) -> None:
    """As `spread_loops`."""
    cross[:, :count] = (weight * root) @ odd[:, :count]


downdate = compiled(downdate_loops) if AVAILABLE else downdate_arrays
square_root = compiled(square_root_loops) if AVAILABLE else square_root_arrays
seen = compiled(seen_loops) if AVAILABLE else seen_arrays
spread = compiled(spread_loops) if AVAILABLE else spread_arrays
