"""How well two sets of windows can be told apart, on motions that the classifier has not seen.

The classifier is a logistic regression with a quadratic penalty (Hosmer, Lemeshow, Applied Logistic
Regression, ch. 1) on features and their squares, in the scale of the training data. 0.5 is chance, 1.0
certainty.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.core.geometry import Array

_PENALTY, _STEPS = 1.0, 25
_FREE = 1e-9
_FLAT = 0.02
"""Least width of a feature, a logarithm or a correlation: smaller differences mean nothing."""
_MOST = 4.0

ByMotion = Mapping[str, Sequence[Array]]
"""Feature vectors of windows, by motion."""


def separation(one: ByMotion, other: ByMotion) -> float:
    """Area under the curve (AUC) of a classifier of two sets, each motion judged by one fitted to the others.

    The mean over the motions that both sets have; NaN where there are fewer than two.
    """
    motions = [name for name in one if len(one[name]) and len(other.get(name, ()))]
    if len(motions) < 2:
        return float("nan")
    found = []
    for held in motions:
        rest = [name for name in motions if name != held]
        table = [np.concatenate([np.stack(side[name]) for name in rest]) for side in (one, other)]
        weights, scale = _fitted(np.concatenate(table), np.repeat([0.0, 1.0], [len(t) for t in table]))
        scores = [_columns(np.stack(side[held]), scale) @ weights for side in (one, other)]
        found.append(auc(scores[0], scores[1]))
    return float(np.mean(found))


def auc(low: Array, high: Array) -> float:
    """Probability that a value of `high` (n,) exceeds one of `low` (m,); equal values count as a half."""
    difference = high[:, np.newaxis] - low[np.newaxis, :]
    return float(np.mean((difference > 0.0) + 0.5 * (difference == 0.0)))


def _fitted(table: Array, label: Array) -> tuple[Array, tuple[Array, Array]]:
    """Weights of the columns, and middle and width of the features; both classes weigh the same."""
    width = np.std(table, axis=0)
    scale = np.mean(table, axis=0), np.maximum(width, _FLAT)
    columns = _columns(table, scale)
    share = np.where(label > 0.5, 0.5 / np.mean(label), 0.5 / np.mean(1.0 - label))
    penalty = _PENALTY * np.eye(columns.shape[1])
    penalty[-1, -1] = _FREE
    weights: Array = np.zeros(columns.shape[1])
    for _ in range(_STEPS):
        sure = 1.0 / (1.0 + np.exp(-columns @ weights))
        slope = columns.T @ (share * (label - sure)) - penalty @ weights
        curve = (columns * (share * sure * (1.0 - sure))[:, np.newaxis]).T @ columns + penalty
        weights = weights + np.linalg.solve(curve, slope)
    return weights, scale


def _columns(table: Array, scale: tuple[Array, Array]) -> Array:
    """Scaled features, their squares, and a constant; what lies far out counts as `_MOST` widths."""
    scaled = np.clip((table - scale[0]) / scale[1], -_MOST, _MOST)
    return np.column_stack([scaled, scaled**2, np.ones(len(table))])
