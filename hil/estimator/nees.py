"""Consistency of a filter: NEES against ground truth, chi-squared bands, whiteness of innovations.

NEES, the normalised estimation error squared, is e' P^-1 e of the error e with the filter's covariance P. For
a consistent filter its mean is the number of states; a larger mean shows an over-confident filter. NIS, the
normalised innovation squared, is the same quantity for an innovation and needs no ground truth. The
innovations of a consistent filter are white.
"""

import numpy as np
from scipy.special import chdtrc, gammaincinv  # scipy.stats takes 1 s to import

from hil.core.geometry import Array

_LEAST_VARIANCE = 1e-14


def nees(error: Array, covariance: Array) -> Array:
    """Normalised estimation error squared (n,) of errors (n, d) with covariances (n, d, d).

    Error and covariance belong to the same states, in the same frame and units. Rows that are not finite
    give NaN. 1e-14 is added to every variance, so that an exactly known state does not make P singular.
    """
    out = np.full(len(error), np.nan)
    known = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    if known.any():
        size = covariance[known] + _LEAST_VARIANCE * np.eye(error.shape[1])
        solved = np.linalg.solve(size, error[known][..., None])[..., 0]
        out[known] = np.sum(error[known] * solved, axis=1)
    return out


def band(degrees: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Interval for the mean of a chi-squared variable over independent runs.

    Args:
        degrees: degrees of freedom in one run.
        runs: number of runs averaged.
        probability: probability that the mean of a consistent filter lies inside.
    """
    total = degrees * runs
    tail = 0.5 * (1.0 - probability)
    low, high = 2.0 * gammaincinv(0.5 * total, [tail, 1.0 - tail]) / runs
    return float(low), float(high)


def autocorrelation(innovation: Array, lags: int = 20) -> Array:
    """Autocorrelation (lags,) of a series (n,) at lags 1, 2, ...; its standard error is 1 / sqrt(n)."""
    centred = innovation - innovation.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return np.zeros(lags)
    return np.array([float(centred[k:] @ centred[:-k]) / power for k in range(1, lags + 1)])


def whiteness(innovation: Array, lags: int = 20) -> float:
    """p-value of the Ljung-Box test: probability that a white series (n,) is at least as correlated."""
    n = len(innovation)
    weight = n * (n + 2.0) / (n - np.arange(1, lags + 1))
    return float(chdtrc(lags, float(weight @ autocorrelation(innovation, lags) ** 2)))
