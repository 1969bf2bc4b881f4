"""Samples interpolated to other instants, NaN across gaps."""

from __future__ import annotations

import math

import numpy as np

from hil.core.geometry import Array


def between_samples(
    at: Array, t: Array, values: Array, *, longest: float, before: float = 0.0, after: float = 0.0
) -> Array:
    """Columns of `values` linearly interpolated, (m, k); NaN where the samples do not reach.

    Args:
        at: (m,) instants wanted.
        t: (n,) times of the samples, in order, in the unit of `at`.
        values: (n, k); NaN everywhere comes of fewer than two.
        longest: gap between samples that is still interpolated; inside a longer one there is nothing.
        before: how far before the first sample it is repeated.
        after: how far after the last sample it is repeated.
    """
    if len(t) < 2:
        return np.full((len(at), values.shape[1]), math.nan)
    found = np.column_stack([np.interp(at, t, column) for column in values.T])
    end = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    in_gap = (t[end] - t[end - 1] > longest) & (at > t[end - 1]) & (at < t[end])
    found[in_gap | (at < t[0] - before) | (at > t[-1] + after)] = math.nan
    return found
