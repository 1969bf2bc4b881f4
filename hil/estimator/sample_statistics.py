"""Noise of a series of samples with confidence intervals: white noise within blocks, drift between blocks.

White noise is the residual of a block about a straight line, so that motion, delay and drift do not count.
Drift is the difference between the means of neighbouring blocks beyond their white noise. Nothing here
depends on a robot or a device.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri  # scipy.stats takes 1 s to import

from hil.core.geometry import Array

_LEAST_SHARE = 0.6
_LINE = 2
_MEDIAN_SQUARE = 0.4549
"""Median of the square of a standard normal variable."""
_MEDIAN_SHARE = 0.37
"""Efficiency of a median of squares: its degrees of freedom per square."""
_THIRD = 20.0
"""Variance of the third difference of white noise of variance 1."""
_THIRD_FREEDOM = 400.0 / 924.0
"""Share of third differences that count as independent: they overlap."""


@dataclass(frozen=True)
class Spread:
    """A variance estimate as a sum of squares and its degrees of freedom.

    Attributes:
        squares: sum of squares, in the squared unit of the series.
        freedom: degrees of freedom of the sum.
    """

    squares: float = 0.0
    freedom: float = 0.0

    def __add__(self, other: Spread) -> Spread:
        return Spread(self.squares + other.squares, self.freedom + other.freedom)

    @property
    def variance(self) -> float:
        """Mean square; NaN without a degree of freedom."""
        return self.squares / self.freedom if self.freedom > 0.0 else math.nan

    def less(self, variance: float) -> Spread:
        """Subtract a known variance, for example the noise of another sensor; never below 0.

        The smaller the share that remains, the fewer degrees of freedom it has.
        """
        if self.squares <= 0.0:
            return self
        left = max(1.0 - variance * self.freedom / self.squares, 0.0)
        freedom = max(self.freedom * left**2, min(self.freedom, 1.0))
        return Spread(left * self.variance * freedom, freedom)

    def per(self, weight: float) -> Spread:
        """Convert to another unit: divide the variance by `weight`."""
        return Spread(self.squares / weight, self.freedom)

    def sigma(self) -> tuple[float, float, float]:
        """Standard deviation and the ends of its 95 % interval; NaN without a degree of freedom."""
        if self.freedom < 1.0:
            return math.nan, math.nan, math.nan
        low, high = (math.sqrt(self.squares / chdtri(self.freedom, p)) for p in (0.025, 0.975))
        return math.sqrt(self.variance), low, high


def total(parts: Iterable[Spread]) -> Spread:
    """Sum of several variance estimates."""
    return sum(parts, Spread())


def blocks(t_s: Array, span_s: float) -> Iterator[slice]:
    """Split a rising series of times (n,) into blocks of `span_s`; blocks with gaps are left out.

    A block needs at least 60 % of the median number of samples, and at least three.
    """
    if len(t_s) < 3:
        return
    number = np.floor((t_s - t_s[0]) / span_s).astype(np.int64)
    edges = np.flatnonzero(np.diff(number)) + 1
    found = [slice(a, b) for a, b in zip((0, *edges), (*edges, len(t_s)), strict=True)]
    usual = float(np.median([part.stop - part.start for part in found]))
    for part in found:
        if part.stop - part.start >= max(3.0, _LEAST_SHARE * usual):
            yield part


def about_a_line(t_s: Array, values: Array) -> Spread:
    """Residual of a series (n,) about its least-squares straight line."""
    if len(t_s) <= _LINE:
        return Spread()
    time, value = t_s - t_s.mean(), values - values.mean()
    power = float(time @ time)
    slope = float(time @ value) / power if power > 0.0 else 0.0
    return Spread(float(np.sum((value - slope * time) ** 2)), len(t_s) - _LINE)


def by_third_differences(t_s: Array, values: Array) -> Spread:
    """White noise of a smooth, evenly sampled series (n,), by third differences; gaps are left out."""
    if len(t_s) < 5:
        return Spread()
    third, step = np.diff(values, 3), np.diff(t_s)
    usual = float(np.median(step))
    even = np.abs(step - usual) < 0.3 * usual
    third = third[even[:-2] & even[1:-1] & even[2:]]
    return Spread(float(np.sum(third**2)) / _THIRD * _THIRD_FREEDOM, _THIRD_FREEDOM * len(third))


@dataclass(frozen=True)
class Change:
    """Change from the mean of one block to the mean of the next.

    Attributes:
        by: difference of the means.
        white: variance of `by` that is due to white noise.
        over: distance between the middles of the blocks, m or s.
    """

    by: float
    white: float
    over: float


def random_walk(changes: Sequence[Change]) -> Spread:
    """Power density of a random walk: variance per unit of `over`.

    The variance between the means of two adjacent blocks of a random walk is 2/3 of its growth from middle to
    middle. Neighbouring differences share a block: two thirds of them count as independent. A part that
    cannot be distinguished from the white noise counts as walk.
    """
    if not changes:
        return Spread()
    by, white, over = (np.array([getattr(c, k) for c in changes]) for k in ("by", "white", "over"))
    grown = float(np.sum(over)) * 2.0 / 3.0
    if grown <= 0.0:
        return Spread()
    freedom = max(2.0 / 3.0 * len(changes), 1.0)
    walked, unseen = float(np.sum(by**2 - white)), float(np.sum(white)) * math.sqrt(2.0 / freedom)
    share = max(walked, unseen) / (max(walked, unseen) + float(np.sum(white)))
    worth = max(freedom * share**2, 1.0)
    return Spread(max(walked, unseen) / grown * worth, worth)


def hardest(changes: Sequence[Change], share: float) -> Spread:
    """Like `random_walk`, from only the given share of the changes that are largest."""
    least = sorted((abs(c.by) for c in changes), reverse=True)[: max(int(share * len(changes)), 1)]
    return random_walk([c for c in changes if abs(c.by) >= least[-1]]) if least else Spread()


def usual(changes: Sequence[Change]) -> Spread:
    """Like `random_walk`, from the median of the squares: rare large changes do not count."""
    if not changes:
        return Spread()
    square = float(np.median([c.by**2 for c in changes])) / _MEDIAN_SQUARE
    usually = [Change(math.sqrt(square), c.white, c.over) for c in changes]
    found = random_walk(usually)
    worth = max(found.freedom * _MEDIAN_SHARE, min(found.freedom, 1.0))
    return Spread(found.variance * worth, worth) if worth > 0.0 else found


DEAD_ZONE = (
    "a noise of exactly 0 means a dead zone: it reports no rate below some limit (the fusion of a BNO055 "
    "none below 3 deg/s), and noise and bias at rest cannot be known"
)
"""What rates of a gyro that are all exactly 0 mean, in words."""


def has_dead_zone(rates: Array) -> bool:
    """Whether rates of a resting gyro, of any shape, are all exactly 0: a gyro that measures has noise."""
    return bool(len(rates)) and not rates.any()
