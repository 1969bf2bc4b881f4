"""Noise of gyro, camera and motion capture at rest, beside the record and what the estimator takes it for.

The mean NIS of a sensor at rest is its variance divided by the one that the estimator takes; with the noise
of the record it is 1 as long as the sensor is what it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hil.config.bench import BenchConfig
from hil.config.robot_record.overlay import known_parts
from hil.core.finding import Finding, Level
from hil.core.signals import Measurements
from hil.estimator.noise_figures import MEASURED, NoiseFigure
from hil.estimator.sample_statistics import Spread, about_a_line, blocks, total
from hil.estimator.tuning import value_of

NOISIER, BETTER = 2.0, 0.5
"""Ratio of the standard deviation to the measured one beyond which a finding warns: twice, or half of it."""
_BLOCK_S = 0.2
_FEWEST = 30.0


_AT_REST = {one.name: one for one in MEASURED if one.state == "rest"}
_OF_POSES = {"tracker": "camera", "mocap": "mocap"}
"""Devices that measure poses, and how their figures begin."""


def noise_at_rest(config: BenchConfig, measured: Measurements) -> Iterator[Finding]:
    """Findings on the sensors' noise; none on a device that delivered too few samples.

    Args:
        config: of the bench.
        measured: all that was watched, aligned, of a robot at rest.
    """
    for one, words, spread in _spreads(measured):
        if spread.freedom >= _FEWEST and one.device in config.devices():
            yield _finding(config, one, words, spread)


def _spreads(m: Measurements) -> Iterator[tuple[NoiseFigure, str, Spread]]:
    """Figures, what they are in words, and their variances."""
    rates = [(s.stamp.t_ns, s.yaw_rate_rad_s) for s in m.gyro if np.isfinite(s.yaw_rate_rad_s)]
    yield _AT_REST["gyro"], "gyro noise at rest", _white(rates, 1)
    for device, begins in _OF_POSES.items():
        poses = [(s.stamp.t_ns, *s.pose) for s in getattr(m, device) if s.valid]
        place = _white(poses, 1) + _white(poses, 2)
        yield _AT_REST[f"{begins}_position"], "position noise at rest", place
        yield _AT_REST[f"{begins}_heading"], "heading noise at rest", _white(poses, 3)


def _white(rows: Sequence[tuple[float, ...]], column: int) -> Spread:
    if len(rows) < 3:
        return Spread()
    t_s = 1e-9 * np.array([row[0] - rows[0][0] for row in rows], dtype=np.float64)
    values = np.array([row[column] for row in rows], dtype=np.float64)
    return total(about_a_line(t_s[part], values[part]) for part in blocks(t_s, _BLOCK_S))


def _finding(config: BenchConfig, one: NoiseFigure, words: str, spread: Spread) -> Finding:
    taken = value_of(config.estimator, one.key)
    part = known_parts(config).get("noise")
    kept = None if part is None else part.figures.get(one.label)
    sigma = spread.sigma()[0]
    found = f"{one.per_si * sigma:.3g} {one.unit}, mean NIS {spread.variance / taken**2:.2g}"
    if kept is None or part is None or kept.value <= 0.0:
        expected = f"the estimator takes {one.per_si * taken:.3g} {one.unit}, not measured"
        level: Level = "warning" if sigma > NOISIER * taken else "ok"
        return Finding(one.device, words, level, found, expected, "hil run sensor_noise measures it")
    ratio = sigma / kept.value
    if not BETTER <= ratio <= NOISIER:
        found += f": {'noisier' if ratio > 1.0 else 'better'} than its record, {ratio:.2g} times"
    expected = f"{BETTER:g} to {NOISIER:g} times the {one.per_si * kept.value:.3g} {one.unit} of its record"
    level = "warning" if ratio > NOISIER else "ok"
    return Finding(
        one.device,
        words,
        level,
        found,
        f"{expected} ({part.measured[:10]})",
        "look at what shakes or dazzles it; if it stays, measure it anew: hil run sensor_noise",
    )
