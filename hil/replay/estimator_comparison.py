"""Other estimators on a recording: error against motion capture, and consistency (NEES).

`compare` runs estimators, `smoothed` the smoother on the recorded measurements; `table` compares them with
motion capture (`hil.replay.truth_errors`, `truth_of`) and with their own covariances (`consistency`);
`fitting` chooses the filters by the sensors that sent data.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hil.bench.pipelines import BenchModel
from hil.config.estimator import EstimatorConfig
from hil.core.errors import DataError
from hil.core.geometry import Array, wrap_array
from hil.core.interfaces import Estimator
from hil.core.known_names import COMPARED, ESTIMATORS
from hil.core.signals import CycleRecord, RobotState, sensors_with_samples
from hil.core.third_party_errors import of_a_script
from hil.datasets.sampling import beside_rows, is_slow
from hil.estimator.nees import autocorrelation, nees
from hil.loop.driven_motion import Motion
from hil.recording.runs import RecordedRun
from hil.replay.truth_errors import RELATIVE_M, errors, samples_of
from hil.robot.kinematics import WheelGeometry
from hil.user_code.checked_calls import checked_update, reset_estimator

SENSORS = {"wheels": "wheels", "gyro": "IMU", "tracker": "camera", "mocap": "motion capture"}
"""Names of sensors by their fields of `Measurements`."""
REST_RAD_S, REST_S = 0.04, 0.1
"""A robot is at rest if its wheels turn slower than this (1 mm/s on wheels of 25 mm) for this long."""


def rest_on_wheels(sensors: Iterable[str]) -> bool:
    """Whether only the wheels measured the motion; motion capture does not count, it is the truth."""
    return not {"gyro", "tracker"} & set(sensors)


def fitting(bench: BenchModel, sensors: Iterable[str]) -> BenchModel:
    """The bench with filters that suit the sensors that sent data."""
    return (
        bench.with_estimator(bench.config.estimator.on_wheels_alone()) if rest_on_wheels(sensors) else bench
    )


def sensors_text(bench: BenchModel, sensors: Sequence[str]) -> str:
    """Sensors of a run in words, and the process noise of the filters if it has wheels alone."""
    absent = [word for name, word in SENSORS.items() if name not in sensors]
    text = "sensors: " + ", ".join(SENSORS[name] for name in sensors)
    if absent:
        text += f"; no {', no '.join(absent)}"
    if bench.config.environment.on_wall and "tracker" not in sensors:
        text += "; on a wall nothing but a camera sees the sag across gravity, so the position is off by it"
    if rest_on_wheels(sensors):
        noise = fitting(bench, sensors).config.estimator.process
        along, turning = noise.acceleration_m_s2_sqrt_hz, noise.angular_acceleration_rad_s2_sqrt_hz
        text += (
            f": the filters rest on the wheels alone, on the {bench.config.environment.kind} of bench "
            f"{bench.config.name}, with a process noise of {along:g} m/s^2 and {turning:g} rad/s^2 per "
            "root Hz"
        )
    return text


def estimate(records: Sequence[CycleRecord], estimator: Estimator, start: RobotState) -> Motion:
    """The run with the states of another estimator, fed with the recorded measurements.

    Raises:
        UsageError: a user's estimator has returned no state, or a wrong one.
    """
    reset_estimator(estimator, start)
    estimate = checked_update(estimator)
    return Motion(tuple(_with_state(r, estimate(r.measurements)) for r in records))


def _with_state(r: CycleRecord, state: RobotState) -> CycleRecord:
    """Like `dataclasses.replace`, which takes four times as long."""
    return CycleRecord(
        r.cycle,
        r.deadline_ns,
        r.start_ns,
        r.inputs,
        r.measurements,
        state,
        r.reference,
        r.setpoint,
        r.command,
        r.events,
        r.observers,
        r.timing_ns,
        r.truth,
    )


def smoothed(
    records: Sequence[CycleRecord],
    config: EstimatorConfig,
    geometry: WheelGeometry,
    surface: str,
    start: RobotState,
) -> Motion:
    """The run with the states of the smoother, which uses all measurements for every cycle."""
    from hil.estimator.smoother import smooth

    states = smooth(config, geometry, surface, [r.measurements for r in records], start)
    return Motion(tuple(map(_with_state, records, states)))


def compare_run(
    run: RecordedRun,
    bench: BenchModel,
    kinds: Sequence[str] = COMPARED,
    *,
    own: Mapping[str, Estimator] = MappingProxyType({}),
    source: str = "the recording",
    recorded: bool = True,
) -> dict[str, Motion]:
    """A run with its recorded estimates (`recorded`), and with those of estimators, by kind or name.

    An observer of the user's own keeps its recorded estimates (`recorded NAME`): a recording has no code.
    Without gyro and camera the filters are those of `fitting`.

    Args:
        run: run to compare, from its first cycle.
        bench: bench that made it; makes the filters and gives the smoother's settings.
        kinds: any of `COMPARED`.
        own: estimators of the user's own by name.
        source: name of the recording, for errors.
        recorded: True if the recording has estimates of its own; a foreign one has none.

    Raises:
        ConfigError: a user's estimator has raised an exception.
        DataError: the recording does not say how the run began.
        UsageError: a user's estimator has returned no state, or a wrong one.
    """
    if run.start is None:
        raise DataError(source, "does not say how its run began")
    bench = fitting(bench, sensors_with_samples(r.measurements for r in run.records))
    start, config = run.start.state, bench.config
    filters = {kind: bench.make_estimator(kind) for kind in kinds if kind != "smoother"}
    motions = compare(run.records, filters, start)
    if "smoother" in kinds:
        motions["smoother"] = smoothed(
            run.records, config.estimator, bench.geometry, config.environment.kind, start
        )
    for name, estimator in own.items():
        with of_a_script(f"estimator {name}"):
            motions[name] = estimate(run.records, estimator, start)
    if not recorded:
        del motions["recorded"]
        return motions
    return {"recorded": motions.pop("recorded"), **_own_observers(run.records), **motions}


def _own_observers(records: Sequence[CycleRecord]) -> dict[str, Motion]:
    """The recorded states of observers that replay cannot run again, the user's own, by row."""
    names = dict.fromkeys(name for r in records for name in r.observers if name not in ESTIMATORS)
    return {
        f"recorded {name}": Motion(
            tuple(_with_state(r, r.observers.get(name) or _nothing(r.measurements.t_ns)) for r in records)
        )
        for name in names
    }


def _nothing(t_ns: int) -> RobotState:
    return RobotState(t_ns, np.full(3, np.nan), np.full(3, np.nan), np.full((6, 6), np.nan))


def table(
    motions: Mapping[str, Motion], align: str = "none", over_m: float = RELATIVE_M
) -> dict[str, dict[str, float | None]]:
    """`errors` and `consistency` of motions of one run by name; None for a missing figure.

    Args:
        motions: motions by name.
        align: alignment of each estimate, one of `hil.core.known_names.ALIGNMENTS`.
        over_m: way over which relative pose errors are taken, m.
    """
    truth = truth_of(next(iter(motions.values()))) if motions else None
    return {
        name: {
            key: value if math.isfinite(value) else None
            for key, value in (errors(motion, align, over_m) | consistency(motion, truth)).items()
        }
        for name, motion in motions.items()
    }


def truth_of(motion: Motion) -> Array:
    """Motion capture at the cycles, (n, 3): interpolated between samples, NaN where it is unknown.

    The last sample counts for the cycles after it (`Motion.mocap`) only while the wheels rest: for a driving
    robot it is out of date. Slow samples count only for the nearest cycle each.
    """
    at_s, poses = samples_of(motion)
    if not len(at_s):
        return motion.mocap
    if is_slow(at_s):
        return beside_rows(motion.t_s, at_s, poses)
    truth = motion.mocap
    age_s = motion.t_s - at_s[-1]
    since = int(np.argmax(age_s > -REST_S))
    angles = Motion(motion.records[since:]).wheels[:, :4]
    turned = np.fmax.accumulate(angles) - np.fmin.accumulate(angles)
    held_s = age_s[since:]
    at_rest = (turned <= REST_RAD_S * (REST_S + held_s)[:, None]).all(axis=1)
    truth[since:][(held_s > 0.0) & ~at_rest] = np.nan
    return truth


def consistency(motion: Motion, truth: Array | None = None) -> dict[str, float]:
    """Consistency of an estimator: its covariance against its errors; `truth` is (n, 3), see `truth_of`.

    Returns:
        `nees_pose`, mean of e' P^-1 e over the cycles (3 is ideal, more is over-confident); running means
        of the normalised innovations at the end (1 is ideal); correlation of the gyro's innovations from one
        cycle to the next (0 is ideal); how many rows each sensor's gates left out; NaN where there is
        no such figure.
    """
    difference = motion.estimate - (truth_of(motion) if truth is None else truth)
    difference[:, 2] = wrap_array(difference[:, 2])
    values = nees(difference, motion.covariance[:, :3, :3]) if len(motion.records) else np.zeros(0)
    last = motion.records[-1].state.diagnostics if motion.records else {}
    known = values[np.isfinite(values)]
    sensors = sensors_with_samples(r.measurements for r in motion.records)
    out = {"nees_pose": float(known.mean()) if len(known) else np.nan}
    for name in ("wheels", "gyro", "tracker", "gravity"):
        out[f"nis_{name}"] = _mean_nis(last, name)
    series = motion.diagnostic("innovation_gyro_rad_s")
    series = series[np.isfinite(series)]
    enough = "gyro" in sensors and len(series) > 2
    out["lag1_gyro"] = float(autocorrelation(series, 1)[0]) if enough else np.nan
    for name in ("wheels", "gyro", "tracker"):
        out[f"rejected_{name}"] = float(last.get(f"rejected_{name}", np.nan)) if name in sensors else np.nan
    return out


def _mean_nis(figures: Mapping[str, float], name: str) -> float:
    """Mean NIS; NaN if no sample was ever compared, because the mean then has its initial, ideal value."""
    mean, latest = figures.get(f"nis_mean_{name}", np.nan), figures.get(f"nis_{name}", 0.0)
    return float("nan") if mean == 1.0 and latest == 0.0 else float(mean)


def compare(
    records: Sequence[CycleRecord], estimators: Mapping[str, Estimator], start: RobotState
) -> dict[str, Motion]:
    """The run as recorded, and with the states of each estimator, by name."""
    motions = {"recorded": Motion(tuple(records))}
    for name, estimator in estimators.items():
        motions[name] = estimate(records, estimator, start)
    return motions


def beside(motions: Mapping[str, Motion]) -> Iterator[CycleRecord]:
    """Records of the first motion, with the estimates of all the others as observers."""
    first, *others = motions.items()
    for k, record in enumerate(first[1].records):
        yield replace(record, observers={name: motion.records[k].state for name, motion in others})
