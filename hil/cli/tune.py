"""`hil tune`: fit the estimator's noise to recordings with ground truth, and save it as configuration."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from hil.cli.completion_types import BENCH
from hil.cli.options import COUPLING, FILE, JSON, OUT, TOPICS, truth_options
from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, EXIT_USAGE, ConfigError, DataError, UsageError
from hil.support.atomic_files import check_ending, check_file, put_whole, refused
from hil.support.file_reading import put_dotted

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig
    from hil.config.estimator import EstimatorConfig
    from hil.core.geometry import Array
    from hil.datasets.azimuth_coupling import Coupling
    from hil.datasets.read import Job
    from hil.datasets.truth_files import TruthFile
    from hil.estimator.tuning import Score, TruthRun, Tuned
    from hil.robot.kinematics import WheelGeometry

_DEFAULT = (
    "wheels.per_sqrt_m",
    "wheels.step_m",
    "tracker.drift_per_sqrt_m",
    "tracker.position_m",
    "process.acceleration_m_s2_sqrt_hz",
    "process.angular_acceleration_rad_s2_sqrt_hz",
    "gyro.rate_rad_s",
)


@click.command()
@click.argument("recordings", nargs=-1, required=True, type=FILE)
@click.option(
    "--check",
    multiple=True,
    type=FILE,
    help="Held-out recording, not fitted (repeatable): exit code 1 where the figures do worse on it.",
)
@click.option(
    "--parameter",
    "names",
    multiple=True,
    help=f"Figure to fit, e.g. wall.creep (repeatable) [default: {', '.join(_DEFAULT)}].",
)
@click.option("--evaluations", default=40, show_default=True, type=click.IntRange(min=2))
@click.option(
    "--bench", type=BENCH, help="Bench file to start from; --out then is a copy of it with the new figures."
)
@click.option("--calibration", type=FILE, help="calibration.toml for the wheels.")
@click.option("--out", type=OUT, help="Write the fitted [estimator] tables here.")
@TOPICS
@truth_options
@COUPLING
@JSON
def command(
    recordings: tuple[Path, ...],
    check: tuple[Path, ...],
    names: tuple[str, ...],
    evaluations: int,
    bench: str | None,
    calibration: Path | None,
    out: Path | None,
    topics: Path | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    as_json: bool,
) -> int:
    """Fit the estimator's noise by the likelihood of the true pose in RECORDINGS.

    Figures that they do not determine, such as the gyro's in recordings of wheels alone, are left out. With
    --check the exit code is 1 if the new figures do worse on recordings that were not fitted. A damaged
    recording is used as far as it can be read, and the exit code is 2. If wheels contradict the ground truth,
    no fit is good: no file is written, and the exit code is 2.

    Example: hil tune out/wall_tracking/first
    """
    from hil.estimator.tuning import score, tune, worse

    if out is not None:
        _check_out(out, bench)
    fitted, held_out = _found(recordings, topics, truth), _found(check, topics, truth)
    if twice := _files(fitted) & _files(held_out):
        raise UsageError(
            f"{min(twice)}: is fitted and held out at once", expected="other recordings for --check"
        )
    seen = _Findings()
    read = partial(
        _read,
        bench=bench,
        calibration=calibration,
        topics=topics,
        truth=truth,
        coupling=coupling,
        findings=seen,
    )
    config, runs = read(_once(recordings, fitted))
    held = read(_once(check, held_out))[1] if check else []
    start = _start(config.estimator, runs)
    pair: tuple[Score, Score] | None = None
    with reporting(quiet=as_json) as report:
        found = tune(start, runs, names or _DEFAULT, evaluations, report, every=bool(names))
    result: dict[str, Any] = {
        "values": dict(found.values),
        "silent": found.silent,
        "untried": found.untried,
        "fitted": {"before": asdict(found.before), "after": asdict(found.after)},
        "evaluations": found.evaluations,
        "geometry": _geometry(runs[0].geometry, bench),
    }
    lost = ""
    if held:
        pair = (score(start, held), score(found.config, held))
        result["held_out"] = {"before": asdict(pair[0]), "after": asdict(pair[1])}
        lost = worse(*pair)
    result["verdict"] = None if pair is None else "FAIL" if lost else "PASS"
    result["problems"] = seen.problems + seen.refused
    result["warnings"] = seen.warnings + [f"{what}; what was readable is used" for what in seen.problems]
    result["warnings"] += [f"{what}; {out} is not written" if out else what for what in seen.refused]
    result["warnings"] += [_do_not_use(check, lost, out)] if lost else []
    for line in result["warnings"]:
        click.echo(f"warning: {line}", err=True)
    if out is not None and not seen.refused:
        _write(out, bench, found)
    click.echo(json.dumps(result) if as_json else _text(found, pair, result["verdict"]))
    return EXIT_LIMIT_FAILED if lost else EXIT_USAGE if result["problems"] else EXIT_PASS


@dataclass
class _Findings:
    """Faults of recordings.

    Attributes:
        problems: problems of damaged ones, of which the readable part is used.
        refused: reasons of those from which nothing is fitted.
        warnings: all other warnings.
    """

    problems: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def _check_out(out: Path, bench: str | None) -> None:
    """Refuse a path that cannot be written, or that holds anything but an earlier result."""
    from hil.support.file_reading import read_toml

    check_ending(out, ".toml")
    check_file(out)
    if not out.is_file():
        return
    if bench is not None and os.path.exists(bench) and out.samefile(bench):
        raise UsageError(
            f"--out {out}: is the bench file itself, whose comments would be lost",
            expected="another name, for a copy of it",
            remedy="compare the copy with it, and take it over",
        )
    if out.stat().st_size and "estimator" not in read_toml(out):
        raise UsageError(
            f"--out {out}: exists already and holds no [estimator], and nothing else is written over",
            remedy="choose another name, or remove it",
        )


def _found(paths: Sequence[Path], topics: Path | None, truth: TruthFile | None) -> list[list[Job]]:
    """The recordings at each path; recordings in a folder are separate jobs."""
    from hil.datasets.read import find_recordings

    return [find_recordings([path], topics, truth=truth) for path in paths]


def _files(found: Sequence[Sequence[Job]]) -> set[Path]:
    """The files, resolved, of recordings."""
    return {file for jobs in found for job in jobs for file in job.identity}


def _once(paths: Sequence[Path], found: Sequence[Sequence[Job]]) -> list[Job]:
    """Recordings at the paths, each file once; a warning names every path that is given more than once."""
    files = [_files([jobs]) for jobs in found]
    kept = list(range(len(paths)))
    for k in reversed(range(len(paths))):
        if any(files[k] <= files[other] for other in kept if other != k):
            kept.remove(k)
            click.echo(f"warning: {paths[k]}: given more than once, taken once", err=True)
    return [job for k in kept for job in found[k]]


def _read(
    jobs: Sequence[Job],
    *,
    bench: str | None,
    calibration: Path | None,
    topics: Path | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    findings: _Findings,
) -> tuple[BenchConfig, list[TruthRun]]:
    """Bench and runs of recordings; `findings` receives what is wrong with them."""
    from hil.calibration.calibration_file import read_calibration
    from hil.calibration.usability_check import check_not_failed
    from hil.calibration.warnings import unused_in
    from hil.datasets.truth_correction import notes_of
    from hil.datasets.wheel_log import Recording
    from hil.datasets.wrong_signs import NO_MOTION, contradictions, is_at_rest
    from hil.estimator.tuning import TruthRun
    from hil.loop.driven_motion import Motion
    from hil.replay.estimator_comparison import truth_of
    from hil.replay.recordings import open_recording

    config, runs, tables, geometry = None, [], list[Recording](), None
    for path in (job.files[0] for job in jobs):
        opened = open_recording(
            path, bench=bench, calibration=calibration, topics=topics, truth=truth, coupling=coupling
        )
        if calibration is not None:
            check_not_failed(read_calibration(calibration), opened.bench.config, str(calibration))
        _same_robot(path, opened.header, opened.bench.config)
        config, found = config or opened.bench.config, list[TruthRun]()
        for run in opened.runs:
            if run.start is None:
                raise DataError(str(path), "does not say how its run began")
            found.append(
                TruthRun(
                    tuple(r.measurements for r in run.records),
                    run.start.state,
                    truth_of(Motion(tuple(run.records))),
                    opened.bench.geometry,
                    opened.bench.config.environment.kind,
                )
            )
        findings.problems += [f"{path}: {what}" for what in opened.problems]
        if all(is_at_rest(_wheel_angles(run)) for run in found):
            findings.refused.append(f"{path}: {NO_MOTION}")
        if opened.tables:
            tables, geometry = [*tables, *opened.tables], opened.bench.geometry
            findings.refused += opened.contradicted_sensors
        usable = [run for run in found if run.can_be_checked()]
        if not usable:
            raise UsageError(f"{path}: has no ground truth to tune on", expected="motion capture in it")
        runs += usable
    if config is None:
        raise UsageError("no recording given")
    if geometry is not None:
        findings.refused += contradictions(tables, geometry)
        findings.warnings += [*unused_in(tables), *notes_of(tables)]
    return config, runs


def _wheel_angles(run: TruthRun) -> Array:
    """Wheel angles (n, 4) of a run, rad."""
    return np.array([w.wheel_angle_rad for m in run.measurements for w in m.wheels]).reshape(-1, 4)


def _start(config: EstimatorConfig, runs: Sequence[TruthRun]) -> EstimatorConfig:
    """Start of the search: the filters that `hil replay` uses for such recordings."""
    from hil.core.signals import sensors_with_samples
    from hil.replay.estimator_comparison import rest_on_wheels

    sensors = sensors_with_samples(m for run in runs for m in run.measurements)
    return config.on_wheels_alone() if rest_on_wheels(sensors) else config


def _same_robot(path: Path, header: dict[str, Any], config: BenchConfig) -> None:
    """Refuse a bench file whose wheels differ from those of the robot in a recording."""
    recorded: dict[str, Any] = header.get("config", {}).get("robot", {})
    mine = config.robot.model_dump()
    keys = ("wheel_x_m", "wheel_y_m", "wheel_radius_m")
    problems = [
        f"robot.{k}: {list(recorded[k])} there, {list(mine[k])} in the bench file"
        for k in keys
        if k in recorded and list(recorded[k]) != list(mine[k])
    ]
    if problems:
        raise ConfigError(
            f"{path}: was recorded with another robot than that of the bench {config.name!r}",
            problems=tuple(problems),
            remedy="give that robot's bench file, or leave --bench out",
        )


def _geometry(used: WheelGeometry, bench: str | None) -> dict[str, object]:
    """The wheel geometry that the estimators use, as results name it."""
    from hil.datasets.nominal_robot import Nominal

    source = "the recording" if bench is None else f"the recording, else bench {bench}"
    described = Nominal(used, source=source).to_json()
    del described["steering_limit_rad"]
    return described


def _write(out: Path, bench: str | None, found: Tuned) -> None:
    """The fitted tables, in a checked copy of the bench file where one was given."""
    import tomli_w

    from hil.config.loading import find_bench, validate

    tree: dict[str, Any] = {}
    if bench is not None:
        tree = find_bench(bench)[0]
    for name, value in found.values.items():
        put_dotted(tree, f"estimator.{name}", float(f"{value:.4g}"), "fitted")
    if "schema" in tree:
        validate(tree, str(out))
    try:
        put_whole(out, tomli_w.dumps(tree).encode())
    except OSError as error:
        raise refused(out, error) from None


def _do_not_use(check: Sequence[Path], lost: str, out: Path | None) -> str:
    """Warning about figures that do worse on held-out recordings, with the remedy."""
    kept = "" if out is None else f"; {out} is written all the same"
    return (
        f"on {', '.join(map(str, check))}, to which they were not fitted, the new figures do worse than "
        f"those before: {lost}; do not use them, fit more recordings or fewer figures (--parameter){kept}"
    )


def _text(found: Tuned, held: tuple[Score, Score] | None, verdict: str | None) -> str:
    lines = [f"{name} = {value:.4g}" for name, value in found.values.items()]
    if found.silent:
        lines.append(f"not fitted, the recordings say nothing about: {', '.join(found.silent)}")
    if found.untried:
        lines.append(f"not reached in {found.evaluations} evaluations: {', '.join(found.untried)}")
    lines.append(f"{'':16} {'-ln L':>9} {'rmse mm':>9} {'rmse deg':>9} {'NEES':>9}")
    rows = [("fitted, before", found.before), ("fitted, after", found.after)]
    if held is not None:
        rows += [("held out, before", held[0]), ("held out, after", held[1])]
    for label, s in rows:
        lines.append(
            f"{label:16} {s.likelihood:9.3f} {1e3 * s.rmse_position_m:9.3f} "
            f"{math.degrees(s.rmse_theta_rad):9.3f} {s.nees:9.3f}"
        )
    if verdict is not None:
        lines.append(
            f"held out: {verdict} ({'better or as good as' if verdict == 'PASS' else 'worse than'} before)"
        )
    return "\n".join(lines)
