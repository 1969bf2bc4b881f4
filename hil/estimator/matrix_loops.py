"""The four most expensive matrix operations, and copies, as loops.

`p` (20, 20) is a covariance. `root` (rows, 20) holds the first rows of the upper triangular U with U' U = P;
row k is the standard deviation of the state along the k-th direction. `h` (8, 20) is a derivative of rows by
the state, `odd` (20, 8) holds odd parts, `cross` (8, 20) is the covariance of rows with the state,
`own` (8, 8) that of the rows.

A library call or a temporary array costs more than the work on a 20x20 matrix. All loops run along rows in
memory, so that the compiler can vectorise them; each sum is added up in the same order as in scalar code.
Where one matrix is read and written (`hil.estimator.process_model`), `check_size` gives the compiler the row
stride; without it the loop is not vectorised. Copies are loops because numba takes four seconds to compile
the error message of an array assignment whose shapes do not match.
"""

import math

import numpy as np

from hil.core.geometry import Array
from hil.estimator.state_vector import ROWS, STATES
from hil.support.numba_jit import inner, kernel

_ZERO_PIVOT = 1e-14


@inner
def check_size(p: Array) -> None:
    """Refuse a matrix that is not (20, 20).

    With the size known to the compiler, loops along the rows are three times as fast.

    Raises:
        ValueError: the matrix has another size.
    """
    if p.shape[0] != STATES or p.shape[1] != STATES:
        raise ValueError("a covariance of 20 states is needed")


@inner
def put(to: Array, of: Array) -> None:
    """Copy a vector: `to[:] = of`, both (n,)."""
    for i in range(to.shape[0]):
        to[i] = of[i]


@inner
def put_rows(to: Array, of: Array) -> None:
    """Fill a matrix (n, m) with the upper left part of another one at least as large."""
    for i in range(to.shape[0]):
        for j in range(to.shape[1]):
            to[i, j] = of[i, j]


@inner
def downdate(p: Array, roots: Array, count: int) -> None:
    """Subtract the outer product r r' of each of the first `count` rows r of roots (8, 20) from p (20, 20).

    In place, two rows per pass: each element of p is read and written half as often.
    """
    check_size(p)
    for k in range(0, count - 1, 2):
        for i in range(STATES):
            first, second = roots[k, i], roots[k + 1, i]
            for j in range(STATES):
                p[i, j] = p[i, j] - first * roots[k, j] - second * roots[k + 1, j]
    if count % 2 == 1:
        for i in range(STATES):
            last = roots[count - 1, i]
            for j in range(STATES):
                p[i, j] -= last * roots[count - 1, j]


@kernel
def square_root(p: Array, root: Array) -> None:
    """Fill `root` (rows, 20) with the first rows of U, where U' U = P, P (20, 20) positive semi-definite.

    A zero pivot leaves a zero row. Row k has no entry left of column k.
    """
    rows, n = root.shape
    for i in range(rows):
        for j in range(n):
            root[i, j] = p[i, j]
    for k in range(rows):
        pivot = root[k, k]
        if pivot <= _ZERO_PIVOT * p[k, k] or pivot <= 0.0:
            root[k, :] = 0.0
            continue
        size = math.sqrt(pivot)
        for j in range(k):
            root[k, j] = 0.0
        root[k, k] = size
        for j in range(k + 1, n):
            root[k, j] = np.divide(root[k, j], size)  # no check for zero: size is positive
        for i in range(k + 1, rows):
            scale = root[k, i]
            for j in range(n):
                root[i, j] -= scale * root[k, j]


@inner
def seen(p: Array, h: Array, count: int, cross: Array, own: Array) -> None:
    """Fill cross (8, 20) = h P and own (8, 8) = h P h' for the first `count` rows of h (8, 20)."""
    n, column = p.shape[0], np.empty(ROWS)
    for i in range(count):
        for j in range(n):
            cross[i, j] = 0.0
        own[i, :] = 0.0
        for k in range(n):
            slope = h[i, k]
            if slope != 0.0:
                for j in range(n):
                    cross[i, j] += slope * p[k, j]
    for k in range(n):
        used = False
        for j in range(ROWS):
            column[j] = h[j, k]
            used |= column[j] != 0.0
        if used:
            for i in range(count):
                scale = cross[i, k]
                for j in range(ROWS):
                    own[i, j] += scale * column[j]


@inner
def spread(root: Array, odd: Array, count: int, weight: float, cross: Array) -> None:
    """Fill cross (8, 20) = weight odd' U for `count` columns of odd (20, 8) and the rows of U in `root`."""
    rows, n = root.shape
    for i in range(count):
        for j in range(n):
            cross[i, j] = 0.0
    for k in range(rows):
        for i in range(count):
            scale = odd[k, i]
            for j in range(n):
                cross[i, j] += (weight * root[k, j]) * scale
