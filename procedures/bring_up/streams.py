"""Statistics of a device's samples: rate, gaps, age on arrival, drift of the device's clock."""

from dataclasses import dataclass

import numpy as np

from hil.config.bench import BenchConfig
from hil.core.geometry import Array
from hil.core.registry import kinds
from hil.core.signals import Status, worst
from hil.loop.driven_motion import Motion
from hil.procedure.sample_arrays import Series, arrivals, camera, encoders, inertial, poses, wheels

_BLOCKS = 24
_FEWEST = 4 * _BLOCKS
"""Samples from which a drift is known."""
_RUN = 20
"""Samples over which a period is taken: bunches even out."""


@dataclass(frozen=True)
class Stream:
    """Statistics of one stream.

    Attributes:
        rate_hz: usable samples per second.
        delivered: usable samples over due samples.
        gap_s: time between measurements: median, 99th percentile, largest.
        age_s: time from measurement to arrival: median and 99th percentile.
        drift_ppm: device clock against the bench clock, positive if it runs fast; NaN without one.
        drift_uncertainty_ppm: half of the 95 % interval.
        too_short: True if there are too few samples for a drift.
        lag: (2, n) time and smallest delay against the device's clock per block, s, for a figure.
    """

    rate_hz: float
    delivered: float
    gap_s: tuple[float, float, float]
    age_s: tuple[float, float]
    drift_ppm: float
    drift_uncertainty_ppm: float
    lag: Array
    too_short: bool = False


def series_of(device: str, motion: Motion, config: BenchConfig) -> Series:
    """Return the usable samples of a device."""
    if device == "servos":
        return wheels(motion)
    if device == "encoders":
        return encoders(motion, config)
    if device == "imu":
        return inertial(motion)
    if device == "tracker":
        return camera(motion)
    return poses(motion, device) if device == "mocap" else arrivals(motion, device)


def due(device: str, motion: Motion, duration_s: float, config: BenchConfig) -> float:
    """Return the number of due samples; from their own period if the device's rate is set by the user."""
    rate_hz = kinds()[device].rate_hz(config.devices()[device], config.loop.rate_hz)
    return duration_s * (1.0 / own_period_s(device, motion) if np.isnan(rate_hz) else rate_hz)


def own_period_s(device: str, motion: Motion) -> float:
    """Return the period of a device's samples, s; two at least.

    Samples may come in bunches, stamped on arrival: the period is that of runs of `_RUN` samples. Where
    the source's numbers show what was lost, it counts; else runs in which little was lost are taken.
    """
    stamps = [s.stamp for r in motion.records for s in r.inputs.of(device) if worst(s) is Status.OK]
    run = min(_RUN, len(stamps) - 1)
    t_s = 1e-9 * np.array([s.t_ns - stamps[0].t_ns for s in stamps])
    seq = np.array([s.seq for s in stamps])
    steps, shows_losses = np.maximum(seq[run:] - seq[:-run], run), bool((np.diff(seq) > 1).any())
    return float(np.quantile((t_s[run:] - t_s[:-run]) / steps, 0.5 if shows_losses else 0.1))


def judge_stream(device: str, motion: Motion, config: BenchConfig) -> Stream:
    """Return the statistics of a device's samples in a motion (at rest, for meaningful ages)."""
    series = series_of(device, motion, config).since(0.0)
    duration_s = float(motion.t_s[-1])
    if len(series) < 10:
        nothing = (np.nan,) * 3
        empty = np.empty((2, 0))
        return Stream(len(series) / duration_s, 0.0, nothing, nothing[:2], np.nan, np.nan, empty)
    gaps, age = np.diff(series.t_s), series.host_s - series.t_s
    drift, uncertainty, lag = clock_drift(series, series.t_s if device == "encoders" else series.host_s)
    return Stream(
        len(series) / duration_s,
        min(1.0, len(series) / due(device, motion, duration_s, config)),
        (float(np.median(gaps)), float(np.percentile(gaps, 99)), float(gaps.max())),
        (float(np.median(age)), float(np.percentile(age, 99))),
        drift,
        uncertainty,
        lag,
        too_short=len(series) < _FEWEST,
    )


def clock_drift(series: Series, arrived_s: Array) -> tuple[float, float, Array]:
    """Return the drift of a device's clock in ppm, half of its 95 % interval, and the fitted delays.

    Transport can only add delay: the smallest delay in each block of time is used, and a robust line
    through these (Theil-Sen) tolerates blocks without a fast sample.

    Args:
        series: samples with the device's own times.
        arrived_s: (n,) arrival on the bench clock. For frames that wait for the loop in a queue
            (encoders) the time of measurement is their arrival.
    """
    known = np.isfinite(series.device_s)
    if known.sum() < _FEWEST:
        return np.nan, np.nan, np.empty((2, 0))
    at, device = arrived_s[known], series.device_s[known]
    delay = at - device
    edges = np.linspace(at[0], at[-1], _BLOCKS + 1)[1:-1]
    blocks = [b for b in np.split(np.arange(len(at)), np.searchsorted(at, edges)) if len(b)]
    best = np.array([b[np.argmin(delay[b])] for b in blocks])
    from scipy.stats import theilslopes  # takes 1 s to import, not needed to drive

    slope, _, low, high = theilslopes(delay[best], device[best], 0.95)
    lag = np.stack([at[best], delay[best] - delay[best].min()])
    return -1e6 * float(slope), 0.5e6 * float(high - low), lag
