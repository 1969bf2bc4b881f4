"""Tests whether a series of measured values is stable: an individuals chart and a trend test.

Control limits are those of Shewhart's chart of individual values: the mean of the first runs, and from it
2.66 mean moving ranges (three standard deviations, if the values are normal) to either side. They describe
the normal variation of the bench; limits describe what is allowed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST, BASE, LOOKED_AT = 8, 20, 30
"""Runs needed for a chart; number of first runs that define it; number of last runs in the trend test."""

_PER_RANGE = 2.66
_CHANCE = 1e-3
_ROUNDING = 1e-9

STEADY, OUTSIDE, DRIFTING, TOO_FEW = "steady", "outside", "drifting", "too few"


@dataclass(frozen=True)
class Chart:
    """Result of the tests on a series of values.

    Attributes:
        state: `steady`, `outside` (the last value is outside the control limits), `drifting`, `too few`.
        centre: mean of the first runs, in the unit of the values; None for too few.
        low, high: control limits, in the same unit; None for too few.
        slope: change per run; 0 unless drifting.
        runs_left: runs until the drift reaches a limit; None if it reaches none.
    """

    state: str
    centre: float | None = None
    low: float | None = None
    high: float | None = None
    slope: float = 0.0
    runs_left: int | None = None


def individuals_chart(values: Sequence[float], low: float | None, high: float | None) -> Chart:
    """Test a series that was measured under equal conditions.

    Args:
        values: values in the order of the runs, all in one unit.
        low: lower limit of the measurement in that unit; None for none.
        high: upper limit in that unit; None for none.
    """
    series = np.asarray(values, float)
    if len(series) < LEAST + 1:
        return Chart(TOO_FEW)
    base = series[: min(BASE, len(series) - 1)]
    centre = float(base.mean())
    reach = _PER_RANGE * float(np.abs(np.diff(base)).mean())
    room = reach + _ROUNDING * float(np.abs(base).max())
    slope = _slope(series[-LOOKED_AT:])
    if slope:
        left = _runs_left(series[-LOOKED_AT:], slope, low, high)
        return Chart(DRIFTING, centre, centre - reach, centre + reach, slope, left)
    state = OUTSIDE if abs(series[-1] - centre) > room else STEADY
    return Chart(state, centre, centre - reach, centre + reach)


def _slope(series: np.ndarray) -> float:
    """Return the change per run (Theil-Sen slope); 0 unless Kendall's test finds a trend."""
    from scipy import stats

    if np.ptp(series) <= _ROUNDING * np.abs(series).max():
        return 0.0
    runs = np.arange(len(series))
    if stats.kendalltau(runs, series).pvalue >= _CHANCE:
        return 0.0
    return float(stats.theilslopes(series, runs).slope)


def _runs_left(series: np.ndarray, slope: float, low: float | None, high: float | None) -> int | None:
    limit = high if slope > 0 else low
    if limit is None:
        return None
    now = float(np.median(series - slope * np.arange(len(series)))) + slope * (len(series) - 1)
    return max(0, int((limit - now) / slope))
