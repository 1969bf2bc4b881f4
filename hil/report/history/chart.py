"""Tests whether a series of measured values stays the same: an individuals chart and a test for a trend.

Control limits are those of Shewhart's chart of individual values: the mean of the first runs, and from it
2.66 mean moving ranges (three standard deviations, if the values are normal) to either side. They say what
the bench does by itself; limits say what it is allowed to do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST, BASE, LOOKED_AT = 8, 20, 30
"""Runs needed for a chart; how many of the first make it; how many of the last are tested for a trend."""

_PER_RANGE = 2.66
_CHANCE = 1e-3
_ROUNDING = 1e-9

STEADY, OUTSIDE, DRIFTING, TOO_FEW = "steady", "outside", "drifting", "too few"


@dataclass(frozen=True)
class Chart:
    """What a series of values does.

    Attributes:
        state: `steady`, `outside` (the last value is none that the bench gave before), `drifting`, `too few`.
        centre: mean of the first runs, in the unit of the values; None for too few.
        low, high: control limits, the same.
        slope: change from run to run; 0 unless drifting.
        runs_left: runs until the drift meets a limit; None where it meets none.
    """

    state: str
    centre: float | None = None
    low: float | None = None
    high: float | None = None
    slope: float = 0.0
    runs_left: int | None = None


def individuals_chart(values: Sequence[float], low: float | None, high: float | None) -> Chart:
    """Judge a series that was measured under the same conditions.

    Args:
        values: in the order of the runs, all in one unit.
        low: lower limit of the measurement in that unit; None for none.
        high: upper limit, the same.
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
    """Change from run to run by Theil and Sen; 0 unless Kendall's test sees a trend."""
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
