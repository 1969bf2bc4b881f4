"""Allan deviation of a rate sensor at rest, with the noise density and bias instability from it."""

import math
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array

FEWEST = 9
_WHITE_UP_TO_S = 0.5
BIAS_FACTOR = math.sqrt(2.0 * math.log(2.0) / math.pi)


@dataclass(frozen=True)
class Allan:
    """Overlapping Allan deviation.

    Attributes:
        tau_s: averaging times, (n,).
        deviation: Allan deviation in the unit of the rate, (n,).
        spread: relative standard deviation of each, (n,).
    """

    tau_s: Array
    deviation: Array
    spread: Array

    def white_noise(self) -> tuple[float, float]:
        """Return noise density (unit times root second) and its standard deviation, from times up to 0.5 s.

        White noise falls with the root of the averaging time (IEEE Std 952, annex C).
        """
        short = self.tau_s <= max(_WHITE_UP_TO_S, self.tau_s[0])
        weight = self.spread[short] ** -2.0
        levels = self.deviation[short] * np.sqrt(self.tau_s[short])
        density = float(np.sum(weight * levels) / np.sum(weight))
        return density, density * float(self.spread[short].min())

    def bias_instability(self) -> tuple[float, float]:
        """Return the bias instability (flat part of the curve) and the averaging time at which it is reached.

        It is an upper bound if the curve still falls at the longest time.
        """
        k = int(np.argmin(self.deviation))
        return float(self.deviation[k] / BIAS_FACTOR), float(self.tau_s[k])


def allan(rate: Array, period_s: float) -> Allan:
    """Return the overlapping Allan deviation of evenly spaced rates, (n,), at about eight times per decade.

    The relative spread is that of white noise with n / m - 1 independent differences.
    """
    angle = np.concatenate([[0.0], np.cumsum(rate - np.mean(rate))]) * period_s
    longest = len(rate) // FEWEST
    sizes = np.unique(np.round(np.geomspace(1, max(longest, 1), 1 + int(8 * math.log10(max(longest, 2))))))
    tau, deviation, spread = [], [], []
    for m in sizes.astype(int).tolist():
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        tau.append(m * period_s)
        deviation.append(math.sqrt(float(np.mean(second**2)) / 2.0) / (m * period_s))
        spread.append(1.0 / math.sqrt(2.0 * (len(rate) / m - 1.0)))
    return Allan(np.array(tau), np.array(deviation), np.array(spread))


def evenly(t_s: Array, values: Array, period_s: float) -> Array:
    """Resample to an even grid by the nearest sample: unlike interpolation this does not smooth noise."""
    grid = np.arange(t_s[0], t_s[-1], period_s)
    after = np.clip(np.searchsorted(t_s, grid), 1, len(t_s) - 1)
    nearest = np.where(grid - t_s[after - 1] < t_s[after] - grid, after - 1, after)
    return np.asarray(values[nearest], dtype=np.float64)
