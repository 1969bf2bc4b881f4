"""Matches the process noise and the wheel noise of a filter to driven runs, by the sensors' NIS.

The noise of single sensors is measured (`hil.estimator.sensor_noise`), and so are the changes of the motion.
What a wheel model makes of the noise of its encoders is not measured: it is scaled so that the typical NIS of
the wheels is 1.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S
from hil.core.signals import Measurements, RobotState, sensors_with_samples
from hil.estimator import make_estimator
from hil.estimator.tuning import value_of, with_values
from hil.robot.kinematics import WheelGeometry
from hil.support.progress import Report, silent

SENSORS = ("wheels", "gyro", "tracker", "mocap")
"""Fields of `Measurements`."""
_CHUNK_NS = NS_PER_S // 4
_SETTLED_NS = NS_PER_S
_WINDOW = 20
"""Samples in the running means of the NIS: about one chunk."""
_SCALED = ("wheels.step_m", "wheels.per_sqrt_m")
_LARGEST = 3.0
"""Largest factor between the wheels' noise and that of the encoders."""
_ROUNDS = 4
_NEAR = 0.03
_TWIST = "process.angular_acceleration_rad_s2_sqrt_hz"
_HIDDEN, _FREER, _FREEST = 0.85, 2.0, 6
"""Lowest accepted NIS of the gyro; factor per step of the angular acceleration; largest number of steps."""


@dataclass(frozen=True)
class DrivenRun:
    """A run with a known start state."""

    measurements: tuple[Measurements, ...]
    start: RobotState


@dataclass(frozen=True)
class Matched:
    """Matched values by dotted name of `[estimator]`, and the resulting typical NIS per row by sensor."""

    values: Mapping[str, float]
    nis: Mapping[str, float]


def usual_nis(
    config: EstimatorConfig, runs: Sequence[DrivenRun], geometry: WheelGeometry, surface: str
) -> dict[str, float]:
    """Typical NIS per row of each sensor with samples; 1 where the filter's covariances are right.

    The median over means of twenty samples: a start, a stop or a steering motion disturbs the robot for a
    moment only and must not decide. The first second of a run, in which the filter finds its biases, is left
    out.
    """
    found: dict[str, list[float]] = {}
    config = config.model_copy(update={"time": config.time.model_copy(update={"nis_samples": _WINDOW})})
    for run in runs:
        estimator = make_estimator(config, geometry, surface=surface)
        estimator.reset(run.start)
        names = [n for n in sensors_with_samples(run.measurements) if n != "mocap" or config.mocap.use]
        for chunk in _chunks(run.measurements):
            figures = estimator.update(chunk).diagnostics
            if chunk.t_ns - run.start.t_ns >= _SETTLED_NS:
                for name in names:
                    found.setdefault(name, []).append(figures[f"nis_mean_{name}"])
    return {name: float(np.median(values)) for name, values in found.items()}


def _chunks(cycles: Sequence[Measurements]) -> Iterator[Measurements]:
    """Merge cycles into chunks of 0.25 s: the same samples in fewer calls."""
    part: list[Measurements] = []
    for m in cycles:
        part.append(m)
        if m.t_ns - part[0].t_ns >= _CHUNK_NS:
            yield _together(part)
            part = []
    if part:
        yield _together(part)


def _together(part: Sequence[Measurements]) -> Measurements:
    samples: dict[str, Any] = {n: tuple(chain.from_iterable(getattr(m, n) for m in part)) for n in SENSORS}
    return Measurements(part[-1].cycle, part[-1].t_ns, **samples)


def match(
    config: EstimatorConfig,
    runs: Sequence[DrivenRun],
    geometry: WheelGeometry,
    surface: str,
    report: Report = silent,
) -> Matched:
    """Raise the angular acceleration noise as far as the gyro's NIS allows; then scale the wheels to NIS 1.

    A filter with too small an angular acceleration rejects the gyro at a start; with too large a value it
    gives the gyro less weight than it could.

    Args:
        config: configuration with the measured noise of the sensors and of the motion.
        runs: driven runs.
        geometry: calibrated wheel parameters.
        surface: `wall` or `floor`.
        report: called with (what, done, total).
    """
    found = Matched({}, usual_nis(config, runs, geometry, surface))

    def done(rounds: int) -> None:
        report("matching", rounds, _ROUNDS + _FREEST)

    if "gyro" in found.nis:
        found = _freest(config, found, lambda c: usual_nis(c, runs, geometry, surface), done)
    return _scaled(
        with_values(config, found.values), found, lambda c: usual_nis(c, runs, geometry, surface), done
    )


Fit = Callable[[EstimatorConfig], dict[str, float]]


def _freest(config: EstimatorConfig, found: Matched, fit: Fit, passed: Callable[[int], object]) -> Matched:
    """Find the largest angular acceleration noise at which the gyro's NIS stays above `_HIDDEN`."""
    own = value_of(config, _TWIST)
    for step in range(1, _FREEST + 1):
        passed(step)
        values = {_TWIST: own * _FREER**step}
        nis = fit(with_values(config, values))
        if nis["gyro"] < _HIDDEN:
            break
        found = Matched(values, nis)
    return found


def _scaled(config: EstimatorConfig, found: Matched, fit: Fit, passed: Callable[[int], object]) -> Matched:
    """Scale the wheels' noise, by a factor of three at most, until their typical NIS is 1."""
    own = {name: value_of(config, name) for name in _SCALED}
    scale, best = 1.0, found.nis
    for done in range(_ROUNDS):
        passed(_FREEST + done)
        off = best.get("wheels", 1.0)
        if abs(math.log(max(off, 1e-9))) < _NEAR:
            break
        tried = min(max(scale * math.sqrt(off), 1.0 / _LARGEST), _LARGEST)
        nis = fit(with_values(config, {n: v * tried for n, v in own.items()}))
        if tried == scale or abs(math.log(nis["wheels"])) >= abs(math.log(off)):
            break
        scale, best = tried, nis
    return Matched({**found.values, **{name: value * scale for name, value in own.items()}}, best)
