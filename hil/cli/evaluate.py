"""`hil evaluate`: odometry error table of recordings."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.nominal_robot_option import BENCH, configured, on_paper
from hil.cli.options import COUPLING, FILE, JSON, PLOTS, TOPICS, truth_options
from hil.cli.progress import reporting
from hil.core.errors import EXIT_PASS, EXIT_USAGE
from hil.robot.kinematics import MODELS

if TYPE_CHECKING:
    from hil.calibration.calibration_file import CalibrationFile
    from hil.calibration.evaluation import Track
    from hil.datasets.azimuth_coupling import Coupling
    from hil.datasets.nominal_robot import Nominal
    from hil.datasets.truth_files import TruthFile
    from hil.datasets.wheel_log import Recording

_BLOCK_S = 0.1
_COLUMNS = ("e_x_m", "e_x_a", "e_y_m", "e_y_a", "e_theta_m", "e_theta_a")


@click.command()
@click.argument("data", nargs=-1, required=True)
@click.option("--calibration", type=FILE, help="calibration.toml to apply.")
@click.option("--model", type=click.Choice(MODELS), help="Forward model [default: exact, or the file's].")
@click.option(
    "--signal",
    type=click.Choice(["position", "velocity"]),
    help="Wheel signal [default: position, or the file's].",
)
@click.option(
    "--deploy",
    type=click.Choice(["parameters", "twist"]),
    default="parameters",
    show_default=True,
    help="Apply the calibration as wheel parameters, or as a 3x3 correction of nominal odometry.",
)
@BENCH
@TOPICS
@truth_options
@COUPLING
@PLOTS
@JSON
def command(
    data: tuple[str, ...],
    calibration: Path | None,
    model: str | None,
    signal: str | None,
    deploy: str,
    bench: str | None,
    topics: Path | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    plots: Path | None,
    as_json: bool,
) -> int:
    """Odometry error table of recordings: folders of odom_N/abs_N pairs, or plain CSV files.

    With --calibration it reports to how many of them the calibration was fitted: errors on those are in
    sample. A calibration that failed its validation run is used, with a warning. If no wheel turns, the
    wheels contradict the ground truth (wheel order, signs, axes), or the geometry is another robot's, the
    exit code is 2.

    Example: hil evaluate recordings/ --calibration calibration.toml
    """
    from hil.calibration.calibration_file import coupling_of
    from hil.calibration.evaluation import evaluate
    from hil.core.errors import UsageError
    from hil.datasets.read import read_recordings
    from hil.support.atomic_files import check_folder

    if deploy == "twist" and calibration is None:
        raise UsageError("--deploy twist needs --calibration FILE")
    if plots is not None:
        check_folder(plots)
    file, robot = _robot(calibration, bench)
    with reporting() as report:
        recordings = read_recordings(
            data,
            lambda done, total: report("reading", done, total),
            topics=topics,
            nominal=robot,
            truth=truth,
            coupling=coupling or (coupling_of(file) if file else None),
        )
    used_model = "exact" if deploy == "twist" else model or (file.model if file else "exact")
    if file is not None and any(one.of_twist for one in recordings):
        raise UsageError(f"{calibration} is of wheels, and --topics names a twist")
    config = configured(bench)
    on_wall = config is not None and config.environment.on_wall
    used = _Used(file, robot, used_model, signal or (file.signal if file else "position"), deploy, on_wall)
    tracks = _tracks(recordings, used)
    table = evaluate(tracks) | used.to_json(calibration, recordings)
    warnings, table["problems"] = _warnings(recordings, used, str(calibration), model)
    table["warnings"] = warnings
    reported = used.in_words(calibration, recordings)
    for line in warnings:
        click.echo(f"warning: {line}", err=True)
    if plots is not None:
        from hil.report.calibration_page import write_evaluation_page

        nominal = _tracks(recordings, replace(used, file=None, deploy="parameters")) if file else None
        click.echo(f"page: {write_evaluation_page(plots, tracks, nominal, table, reported)}", err=True)
    click.echo(json.dumps(table) if as_json else _text(table, reported))
    return EXIT_USAGE if table["problems"] else EXIT_PASS


@dataclass(frozen=True)
class _Used:
    """Basis of the odometry: calibration or None, nominal robot, model, signal, deployment, surface."""

    file: CalibrationFile | None
    robot: Nominal
    model: str
    signal: str
    deploy: str
    on_wall: bool

    def to_json(self, calibration: Path | None, recordings: list[Recording]) -> dict[str, Any]:
        """Its keys of the JSON."""
        from hil.calibration.applied_warnings import in_sample

        file = self.file
        keys: dict[str, Any] = {
            "model": self.model,
            "signal": self.signal,
            "calibration": str(calibration) if file else None,
            "geometry": self.robot.to_json(),
        }
        if file is not None:
            keys |= {"deploy": self.deploy, "fitted_with": {"model": file.model, "signal": file.signal}}
            keys["in_sample"] = in_sample(file, recordings).to_json()
        return keys

    def in_words(self, calibration: Path | None, recordings: list[Recording]) -> list[str]:
        """Lines on the calibration, for the head of the table."""
        from hil.calibration.applied_warnings import in_sample

        if self.file is None:
            return []
        fitted = f"fitted with model {self.file.model}, signal {self.file.signal}"
        return [
            f"calibration {calibration}, {fitted}, applied as {self.deploy}",
            in_sample(self.file, recordings).in_words(),
        ]


def _warnings(
    recordings: list[Recording], used: _Used, calibration: str, model: str | None
) -> tuple[list[str], list[str]]:
    """All warnings, and those of them that make the exit code 2."""
    from hil.calibration.applied_warnings import used_otherwise
    from hil.calibration.usability_check import failed_validation
    from hil.calibration.warnings import crossed_gaps, warnings_of
    from hil.datasets.sensor_checks import sensor_contradictions
    from hil.datasets.wrong_signs import contradictions, without_motion

    file, robot = used.file, used.robot
    failed = "" if file is None else failed_validation(file, calibration)
    warnings = [failed, *warnings_of(recordings)] if failed else warnings_of(recordings)
    warnings += crossed_gaps(recordings) if used.model == "paper" else []
    warnings += [] if file is None else used_otherwise(file, model, used.signal, used.deploy)
    geometry = robot.geometry if file is None else file.geometry
    contradicted = contradictions(recordings, geometry)
    for one in recordings:
        contradicted += sensor_contradictions(one, geometry, on_wall=used.on_wall)
    refused = (
        without_motion(recordings) + contradicted + _of_another_robot(recordings, used, bool(contradicted))
    )
    warnings += _doubts(recordings, used) + refused
    return warnings, [f"{r.name}: {what}" for r in recordings for what in r.problems] + refused


def _robot(calibration: Path | None, bench: str | None) -> tuple[CalibrationFile | None, Nominal]:
    """The calibration, and the nominal robot: the calibration's own, else the bench's, else the CAD model.

    Raises:
        ConfigError: the calibration was made for another robot than the bench's.
    """
    from hil.calibration.calibration_file import read_calibration
    from hil.calibration.usability_check import check_made_for

    config = configured(bench)
    robot = on_paper(config)
    if calibration is None:
        return None, robot
    file = read_calibration(calibration)
    if config is not None:
        check_made_for(file, config, str(calibration))
    return file, replace(robot, geometry=file.nominal_geometry, source=str(calibration))


def _tracks(recordings: list[Recording], used: _Used) -> list[Track]:
    from hil.calibration.evaluation import track_all

    file = used.file
    if file is not None and used.deploy == "twist":
        return track_all(recordings, file.nominal_geometry, "exact", used.signal, file.twist)
    geometry = file.geometry if file is not None else used.robot.geometry
    return track_all(recordings, geometry, used.model, used.signal)


def _of_another_robot(recordings: list[Recording], used: _Used, contradicted: bool) -> list[str]:
    """One line where the nominal geometry cannot be that of the recorded robot; else none."""
    from hil.calibration.excitation import BENCH_FILE, OTHER_ROBOT, mismatch
    from hil.datasets.fit_blocks import reduce_recordings

    if any(one.contradictions for one in recordings):
        return []
    found = mismatch(reduce_recordings(recordings, _BLOCK_S, used.signal), used.robot)
    return [f"{found}; {BENCH_FILE if contradicted else OTHER_ROBOT}"] if found else []


def _doubts(recordings: list[Recording], used: _Used) -> list[str]:
    """Reasons to doubt the errors of a calibration: motions that were never fitted, or another deployment."""
    from hil.calibration.cross_validation import deployed
    from hil.calibration.excitation import Driven
    from hil.calibration.problem import make_setting
    from hil.calibration.warnings import beyond_driven, worse_as_twist
    from hil.datasets.fit_blocks import reduce_recordings

    file, out = used.file, list[str]()
    if file is None:
        return out
    if file.driven_m:
        blocks = reduce_recordings(recordings, _BLOCK_S, used.signal)
        out += beyond_driven(blocks, used.robot.geometry, Driven.from_json(file.driven_m))
    if used.deploy == "twist":
        setting = make_setting("recommended", model=file.model, signal=used.signal)
        out += worse_as_twist(
            deployed(recordings, file.geometry, file.nominal_geometry, file.twist, setting), file.model
        )
    return out


def _text(table: dict[str, Any], warnings: list[str]) -> str:
    geometry = table["geometry"]
    lines = [
        f"{table['recordings']} recordings, model {table['model']}, signal {table['signal']}, "
        f"cost J = {table['cost']:.1f}",
        f"nominal robot: {geometry['source']}",
        *warnings,
        f"{'motion':14}" + "".join(f"{c:>10}" for c in _COLUMNS) + f"{'RMSE mm':>10}{'RMSE deg':>10}",
    ]
    motions: dict[str, dict[str, float]] = table["motions"]
    for name, row in motions.items():
        lines.append(
            f"{name:14}"
            + "".join(f"{row[c]:10.4f}" for c in _COLUMNS)
            + f"{row['rmse_position_m'] * 1e3:10.2f}{math.degrees(row['rmse_theta_rad']):10.2f}"
        )
    mean: dict[str, float] = table["mean"]
    lines.append(
        f"{'mean':74}{mean['rmse_position_m'] * 1e3:10.2f}{math.degrees(mean['rmse_theta_rad']):10.2f}"
    )
    return "\n".join(lines)
