"""Interpolates samples to other instants; NaN across gaps."""

import math

import numpy as np

from hil.core.geometry import Array


def between_samples(
    at: Array, t: Array, values: Array, *, longest: float, before: float = 0.0, after: float = 0.0
) -> Array:
    """Interpolate the columns of `values` linearly, (m, k); NaN outside the samples and inside gaps.

    Args:
        at: (m,) instants wanted.
        t: (n,) times of the samples, in order, in the unit of `at`.
        values: values (n, k) of the samples; with fewer than two samples the result is all NaN.
        longest: longest gap between samples that is interpolated; NaN inside a longer one.
        before: time before the first sample for which it is repeated.
        after: time after the last sample for which it is repeated.
    """
    if len(t) < 2:
        return np.full((len(at), values.shape[1]), math.nan)
    found = np.column_stack([np.interp(at, t, column) for column in values.T])
    end = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    in_gap = (t[end] - t[end - 1] > longest) & (at > t[end - 1]) & (at < t[end])
    found[in_gap | (at < t[0] - before) | (at > t[-1] + after)] = math.nan
    return found
