"""White noise of a sensor, measured from its own samples while the filter runs.

Three successive samples contain the noise three times, but of the motion only its change of speed. So their
second difference, here for uneven steps, estimates the noise without a model and without the state (Gasser,
Sroka and Jennen-Steinmetz, 1986). What changes slowly does not count: a turned camera, a wrong scale, drift,
lag and slipping wheels leave the measured noise as it is, and their innovations stay contradictions.
"""

import math

from hil.core.named_records import Record
from hil.support.numba_jit import inner

_LOUDER = 2.0
"""Measured over configured variance from which on the measured one is used: 4 sigma above 1."""
_PRIOR, _SAMPLES = 20.0, 200.0
"""Weight of the configured variance at the start, and length of the running mean, in samples."""
_LONGEST_S, _UNEVEN = 0.05, 2.0
"""Longest step, and largest ratio of successive ones: beyond them the motion between the samples counts."""
_OUTLIER = 10.83
"""Largest square that counts, in units of the variance: a single outlier is no noise."""


class MeasuredNoise(Record):
    """Noise of one row.

    Attributes:
        value, step, dt_s: last sample, its difference from the sample before, and the time between them;
            `dt_s` is 0 where there is no sample before, and negative where there is none at all.
        samples: number of second differences up to now, at most `_SAMPLES`.
        ratio: measured variance over the configured one.
        factor: factor on the configured variance: the ratio where it is clearly above 1, else 1.
    """

    value: float
    step: float
    dt_s: float
    samples: float
    ratio: float
    factor: float


START = {"dt_s": -1.0, "ratio": 1.0, "factor": 1.0}
"""Start values."""


@inner
def measure(own: MeasuredNoise, value: float, dt_s: float, var: float) -> None:
    """Take a sample, `dt_s` after the one before; `var` is its configured variance. NaN: it is missing."""
    if not math.isfinite(value):
        own.dt_s = -1.0
        return
    step, before_s = value - own.value, own.dt_s
    own.value, own.dt_s = value, dt_s if before_s >= 0.0 else 0.0
    even = before_s <= _UNEVEN * dt_s and dt_s <= _UNEVEN * before_s
    if before_s > 0.0 and even and dt_s <= _LONGEST_S:
        longer = dt_s / before_s
        bend = step - longer * own.step
        found = bend * bend / (var * (1.0 + (1.0 + longer) * (1.0 + longer) + longer * longer))
        own.samples = min(own.samples + 1.0, _SAMPLES)
        own.ratio += (min(found, _OUTLIER * own.ratio) - own.ratio) / (_PRIOR + own.samples)
        own.factor = own.ratio if own.ratio > _LOUDER else 1.0
    own.step = step
