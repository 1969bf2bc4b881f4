"""How much later than a command a signal follows, from a whole motion of many small reversals.

Everything is compared as a way: the command and rate signals are integrated, so that a joint's angle, a
turn rate and a heading have the same shape, a rounded triangle, and the same lag of the motors in it.
What is found is nearly the mean delay of the response (its first moment), which adds up along a chain:
a few percent of a lag less, because corners rounded by it count less. Between two signals that have the
same lag in them it drops out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from hil.clock import NS_PER_S
from hil.geometry import Array
from hil.motion import Motion

_BLOCKS = 8
_EARLIEST_S, _LATEST_S = -0.15, 0.6
_SECTIONS = ("read", "estimate", "control")


@dataclass(frozen=True)
class Delay:
    """Mean delay of a signal behind the command; `uncertainty_s` is half of the 95 % interval.

    Attributes:
        gain: size of the signal over that of the command.
        misfit: RMS of what is left over the RMS of the signal: 1 is a signal that does not follow.
    """

    delay_s: float
    uncertainty_s: float
    gain: float
    misfit: float


class Command:
    """The way that was commanded: what was sent when, held until the next.

    Args:
        t_s: (n,) when each command was handed to the bus.
        value: (n,) what it was, the rate of the way; for positions give their own steps with `as_way`.
    """

    def __init__(self, t_s: Array, value: Array) -> None:
        self._t_s = t_s
        self._way = np.concatenate([[0.0], np.cumsum(value[:-1] * np.diff(t_s))])

    def way(self, t_s: Array) -> Array:
        """Commanded way at any time."""
        return np.asarray(np.interp(t_s, self._t_s, self._way), dtype=np.float64)


def sent_s(motion: Motion) -> Array:
    """(n,) when each cycle's command was handed to the bus, s since the first cycle began."""
    origin_ns = motion.records[0].inputs.t_ns
    return np.array(
        [
            (r.start_ns + sum(r.timing_ns.get(k, 0) for k in _SECTIONS) - origin_ns) / NS_PER_S
            for r in motion.records
        ]
    )


def integrated(t_s: Array, rate: Array) -> Array:
    """Way of a rate signal."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)
    return np.concatenate([np.zeros(min(len(rate), 1)), np.cumsum(steps)])


def fit_delay(command: Command, t_s: Array, way: Array) -> Delay:
    """Delay of a way behind the commanded one; an offset and a steady drift of the signal do not matter.

    NaN where there are too few samples. The interval comes from leaving out each eighth of the motion.
    """
    known = np.isfinite(way)
    t, y = t_s[known], way[known]
    if len(t) < 10 * _BLOCKS:
        return Delay(math.nan, math.nan, math.nan, math.nan)
    whole = _best(command, t, y)
    part = np.minimum(((t - t[0]) / (t[-1] - t[0]) * _BLOCKS).astype(int), _BLOCKS - 1)
    without = np.array([_best(command, t[part != k], y[part != k]) for k in range(_BLOCKS)])
    spread = math.sqrt((_BLOCKS - 1) / _BLOCKS * float(np.sum((without - without.mean()) ** 2)))
    residual, gain = _fit(command, t, y, whole)
    level = float(np.std(y - np.polyval(np.polyfit(t, y, 1), t)))
    return Delay(whole, 2.36 * spread, gain, math.sqrt(residual / len(t)) / max(level, 1e-12))


def _best(command: Command, t: Array, y: Array) -> float:
    coarse = np.arange(_EARLIEST_S, _LATEST_S, 0.02)
    start = float(coarse[np.argmin([_fit(command, t, y, tau)[0] for tau in coarse])])
    found = minimize_scalar(
        lambda tau: _fit(command, t, y, tau)[0], bounds=(start - 0.03, start + 0.03), method="bounded",
        options={"xatol": 1e-6},
    )  # fmt: skip
    return float(found.x)


def _fit(command: Command, t: Array, y: Array, tau_s: float) -> tuple[float, float]:
    """(sum of squared errors, gain) with the best offset, drift and gain at a delay."""
    middle = t.mean()
    design = np.column_stack([command.way(t - tau_s), np.ones_like(t), t - middle])
    best = np.linalg.lstsq(design, y, rcond=None)[0]
    return float(np.sum((y - design @ best) ** 2)), float(best[0])
