"""Fits the noise of the estimator to recordings with ground truth, by maximum likelihood.

The score has two parts. The first is the mean negative log likelihood of the true pose under the estimate,
1/2 (ln det P + e' P^-1 e), at instants half a second apart. It rewards small errors and honest covariances at
once, and is least where NEES is ideal. It alone cannot correct a noise of single samples that is far too
small, because the pose hardly depends on it. So for wheels, gyro and camera the divergence between the actual
and the expected innovations is added, 1/2 (r - 1 - ln r) with the mean NIS r per row, which is 0 at r = 1.
The gravity heading is left out: its errors are correlated over seconds. The search changes one figure after
the other by a factor, keeps what helps and refines the factor. It uses no derivative and no randomness, so
the result is the same every time. A figure on which no score depends is not fitted.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.errors import UsageError
from hil.core.geometry import Array, wrap_array
from hil.core.signals import Measurements, RobotState, sensors_with_samples
from hil.estimator import make_estimator
from hil.estimator.nees import nees
from hil.robot.kinematics import WheelGeometry
from hil.support.file_reading import put_dotted
from hil.support.progress import Report, silent

CHECK_EVERY_NS = 500_000_000
_FACTORS = (3.0, 1.7, 1.3)
_LEAST_GAIN = 1e-3
_CLEARLY_WORSE = 1e-2
_SENSORS = {"gyro", "tracker"}
"""Noise tables of sensors that a recording may lack."""
_WHITE = ("wheels", "gyro", "tracker")
_STEP_RESOLUTION_M = 1e-4
_HEADING_RESOLUTION_RAD = 2e-4


@dataclass(frozen=True)
class TruthRun:
    """One run with ground truth at its cycles: measurements, start, true poses (n, 3), NaN where unknown."""

    measurements: tuple[Measurements, ...]
    start: RobotState
    truth: Array
    geometry: WheelGeometry
    surface: str

    def can_be_checked(self) -> bool:
        """Whether the truth is known at any cycle from the first checked instant on."""
        begin_ns = self.start.t_ns + CHECK_EVERY_NS
        late = np.array([m.t_ns >= begin_ns for m in self.measurements])
        return bool(np.any(np.isfinite(self.truth[late]).all(axis=1)))


@dataclass(frozen=True)
class Score:
    """Performance of an estimator on runs.

    Attributes:
        likelihood: mean negative log likelihood of the true pose plus `innovations`; the search minimises it.
        innovations: divergence between actual and expected innovations, summed over sensors.
        rmse_position_m, rmse_theta_rad, nees: errors against the truth.
    """

    likelihood: float
    innovations: float
    rmse_position_m: float
    rmse_theta_rad: float
    nees: float


@dataclass(frozen=True)
class Tuned:
    """Result of a search.

    Attributes:
        config: configuration with the fitted values.
        values: the fitted values by dotted name.
        silent: names on which no score depends.
        untried: names that the budget did not reach.
        before, after: scores at the start and at the end.
        evaluations: number of times that all runs were estimated.
    """

    config: EstimatorConfig
    values: Mapping[str, float]
    silent: tuple[str, ...]
    untried: tuple[str, ...]
    before: Score
    after: Score
    evaluations: int


def tunable(config: EstimatorConfig, surface: str) -> dict[str, float]:
    """Noise figures above 0 that a search may change, by dotted name."""
    names = {
        "process": ("acceleration_m_s2_sqrt_hz", "angular_acceleration_rad_s2_sqrt_hz"),
        "wheels": ("step_m", "per_sqrt_m", "steering_m_rad"),
        surface: (
            "slip_m_s",
            "slip_across_m_s",
            "creep",
            "creep_across",
            "creep_per_sqrt_m",
            "yaw_rad_m",
            "yaw_per_sqrt_m",
        ),
        "gyro": ("rate_rad_s", "bias_rad_s", "gravity_rad", "gravity_offset_rad"),
        "tracker": ("position_m", "heading_rad", "drift_per_sqrt_m", "yaw_drift_per_sqrt_s", "scale_sigma"),
    }
    tree = config.model_dump()
    found = {f"{table}.{key}": float(tree[table][key]) for table, keys in names.items() for key in keys}
    return {name: value for name, value in found.items() if value > 0.0}


def value_of(config: EstimatorConfig, name: str) -> float:
    """Value of a configuration key by its dotted name, in SI units."""
    table, key = name.split(".")
    return float(getattr(getattr(config, table), key))


def with_values(config: EstimatorConfig, values: Mapping[str, float]) -> EstimatorConfig:
    """Copy of the configuration with some values replaced; raises `ValueError` for an impossible one."""
    tree: dict[str, Any] = config.model_dump()
    for name, value in values.items():
        put_dotted(tree, name, value, "estimator")
    return EstimatorConfig.model_validate(tree)


def score(config: EstimatorConfig, runs: Sequence[TruthRun]) -> Score:
    """Run an estimator over all runs and compare it with the truth."""
    every, errors, figures = [], [], []
    for run in runs:
        error, covariance, nis = _checked(config, run)
        figures.append(nis)
        squared = nees(error, covariance)
        size = covariance + np.diag([_STEP_RESOLUTION_M**2] * 2 + [_HEADING_RESOLUTION_RAD**2])
        every.append(np.column_stack([0.5 * (np.linalg.slogdet(size)[1] + nees(error, size)), squared]))
        errors.append(error)
    value, squared = np.concatenate(every).mean(axis=0)
    error = np.concatenate(errors)
    apart = divergence(np.concatenate(figures))
    return Score(
        float(value) + apart,
        apart,
        float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))),
        float(np.sqrt(np.mean(error[:, 2] ** 2))),
        float(squared),
    )


def worse(before: Score, after: Score) -> str:
    """How far the fitted figures do worse on recordings not used in the fit; empty where they do not.

    Args:
        before: score of those recordings with the figures that the search began with.
        after: their score with the fitted figures; worse means a `likelihood` higher by more than 0.01.
    """
    if after.likelihood <= before.likelihood + _CLEARLY_WORSE:
        return ""
    return (
        f"-ln L {before.likelihood:.2f} -> {after.likelihood:.2f}, "
        f"RMSE {1e3 * before.rmse_position_m:.3f} -> {1e3 * after.rmse_position_m:.3f} mm and "
        f"{math.degrees(before.rmse_theta_rad):.3f} -> {math.degrees(after.rmse_theta_rad):.3f} deg, "
        f"NEES {before.nees:.2f} -> {after.nees:.2f}"
    )


def divergence(nis: Array) -> float:
    """Sum over sensors of 1/2 (r - 1 - ln r), r the mean of a column of NIS (k, sensors).

    This is the Kullback-Leibler divergence between innovations of r times the expected variance and the
    expected ones. A sensor without samples adds 0.
    """
    r = nis.mean(axis=0)
    known = r[r > 0.0]
    return float(np.sum(0.5 * (known - 1.0 - np.log(known))))


def _checked(config: EstimatorConfig, run: TruthRun) -> tuple[Array, Array, Array]:
    """Errors (k, 3), covariances (k, 3, 3) and mean NIS per row and sensor (k, 3) at the checked instants."""
    estimator = make_estimator(config, run.geometry, surface=run.surface)
    estimator.reset(run.start)
    next_ns, error, covariance, nis = run.start.t_ns + CHECK_EVERY_NS, [], [], []
    for m, truth in zip(run.measurements, run.truth, strict=True):
        state = estimator.update(m)
        if m.t_ns >= next_ns and np.all(np.isfinite(truth)):
            next_ns += CHECK_EVERY_NS
            error.append(state.pose_body_in_wall - truth)
            covariance.append(state.covariance[:3, :3])
            nis.append([_nis(state, name) for name in _WHITE])
    if not error:
        raise UsageError("a recording has no ground truth to tune on", expected="motion capture in it")
    out = np.array(error)
    out[:, 2] = wrap_array(out[:, 2])
    return out, np.array(covariance), np.array(nis)


def _nis(state: RobotState, sensor: str) -> float:
    """Mean NIS per row by the variances of the configuration; 0 for a sensor without samples.

    The filter's own, with variances that it measures where those are too small, would show none too small.
    """
    figures = state.diagnostics
    if not math.isfinite(figures.get(f"age_{sensor}_s", math.inf)):
        return 0.0
    factors = [value for name, value in figures.items() if name.startswith(f"noise_{sensor}")]
    return figures[f"nis_mean_{sensor}"] * (sum(factors) / len(factors) if factors else 1.0)


def tune(
    config: EstimatorConfig,
    runs: Sequence[TruthRun],
    names: Sequence[str],
    evaluations: int = 60,
    report: Report = silent,
    *,
    every: bool = False,
) -> Tuned:
    """Fit noise figures to runs with ground truth.

    Args:
        config: configuration to start from.
        runs: recordings with ground truth.
        names: dotted names of `tunable`, in the order in which they are tried.
        evaluations: budget: largest number of times that all runs are estimated.
        report: called with (what, done, total).
        every: True to refuse a name on which no score depends; else it is left out.

    Raises:
        UsageError: a name that cannot be tuned, or a run without truth.
    """
    start = tunable(config, runs[0].surface)
    unknown = [n for n in names if n not in start]
    if unknown or not names:
        raise UsageError(
            f"cannot tune {', '.join(unknown) or 'nothing'}", expected="some of " + ", ".join(start)
        )
    sensors = {name for run in runs for name in sensors_with_samples(run.measurements)}
    mute = {n for n in names if n.split(".")[0] in _SENSORS - sensors}
    _refuse(mute if every else set())
    values, used = {n: start[n] for n in names if n not in mute}, 1
    tried, matter = set[str](), set[str]()
    before = best = score(config, runs)
    for factor in _FACTORS:
        improved = True
        while improved and used < evaluations:
            improved = False
            for name, change in ((n, c) for n in tuple(values) for c in (factor, 1.0 / factor)):
                if used >= evaluations:
                    break
                trial = {**values, name: values[name] * change}
                found, used = _tried(config, trial, runs), used + 1
                report("tuning", used, evaluations)
                tried.add(name)
                if found is not None and found != best:
                    matter.add(name)
                if found is not None and found.likelihood < best.likelihood - _LEAST_GAIN:
                    values, best, improved = trial, found, True
            _refuse(tried - matter if every else set())
            values = {n: value for n, value in values.items() if n in matter or n not in tried}
    fitted = {n: value for n, value in values.items() if n in matter}
    untried = tuple(n for n in values if n not in tried)
    left_out = tuple(n for n in names if n not in values)
    return Tuned(with_values(config, fitted), fitted, left_out, untried, before, best, used)


def _refuse(mute: Set[str]) -> None:
    """Raise `UsageError` for names on which no score depends."""
    if mute:
        raise UsageError(
            f"the recordings say nothing about {', '.join(sorted(mute))}: no estimate depends on it",
            expected="figures of sensors and motions that they have",
            remedy="leave it out, or give recordings that show it",
        )


def _tried(config: EstimatorConfig, values: Mapping[str, float], runs: Sequence[TruthRun]) -> Score | None:
    try:
        found = score(with_values(config, values), runs)
    except ValueError:
        return None
    return found if math.isfinite(found.likelihood) else None
