"""`hil evaluate`: odometry error table of recordings."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import COUPLING, FILE, JSON, PLOTS, TOPICS, truth_options
from hil.cli.progress import reporting
from hil.cli.robot_of_recordings import BENCH, configured, on_paper
from hil.core.errors import EXIT_PASS, EXIT_USAGE
from hil.robot.kinematics import MODELS

if TYPE_CHECKING:
    from hil.calibration.calibration_file import CalibrationFile
    from hil.calibration.evaluation import Track
    from hil.datasets.azimuth_coupling import Coupling
    from hil.datasets.dataset import Recording
    from hil.datasets.nominal_robot import Nominal
    from hil.datasets.truth_files import TruthFile

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
    sample. A calibration that failed its validation run is used, with a warning. If no wheel turns, or the
    wheels contradict the ground truth (wheel order, signs, axes), the exit code is 2.

    Example: hil evaluate recordings/ --calibration calibration.toml
    """
    from hil.calibration.applied_warnings import in_sample, used_otherwise
    from hil.calibration.calibration_file import coupling_of
    from hil.calibration.evaluation import evaluate
    from hil.calibration.usability_check import failed_validation
    from hil.calibration.warnings import crossed_gaps, warnings_of
    from hil.core.errors import UsageError
    from hil.datasets.read import read_recordings
    from hil.datasets.wrong_signs import contradictions, without_motion
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
    used_signal = signal or (file.signal if file else "position")
    tracks = _tracks(recordings, file, robot, used_model, used_signal, deploy)
    table = evaluate(tracks)
    table |= {"model": used_model, "signal": used_signal, "calibration": str(calibration) if file else None}
    table["geometry"] = robot.to_json()
    reported: list[str] = []
    if file is not None:
        seen = in_sample(file, recordings)
        table |= {"deploy": deploy, "fitted_with": {"model": file.model, "signal": file.signal}}
        table["in_sample"] = seen.to_json()
        reported = [
            f"calibration {calibration}, fitted with model {file.model}, signal {file.signal}, "
            f"applied as {deploy}",
            seen.in_words(),
        ]
    failed = "" if file is None else failed_validation(file, str(calibration))
    warnings = [failed, *warnings_of(recordings)] if failed else warnings_of(recordings)
    warnings += crossed_gaps(recordings) if used_model == "paper" else []
    warnings += [] if file is None else used_otherwise(file, model, used_signal, deploy)
    geometry = robot.geometry if file is None else file.geometry
    contradicted = contradictions(recordings, geometry)
    refused = without_motion(recordings) + contradicted
    warnings += _doubts(recordings, file, robot, used_signal, deploy, bool(contradicted)) + refused
    table["warnings"] = warnings
    table["problems"] = [f"{r.name}: {what}" for r in recordings for what in r.problems] + refused
    for line in warnings:
        click.echo(f"warning: {line}", err=True)
    if plots is not None:
        from hil.report.calibration_page import write_evaluation_page

        nominal = _tracks(recordings, None, robot, used_model, used_signal, "parameters") if file else None
        click.echo(f"page: {write_evaluation_page(plots, tracks, nominal, table, reported)}", err=True)
    click.echo(json.dumps(table) if as_json else _text(table, reported))
    return EXIT_USAGE if table["problems"] else EXIT_PASS


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


def _tracks(
    recordings: list[Recording],
    file: CalibrationFile | None,
    robot: Nominal,
    model: str,
    signal: str,
    deploy: str,
) -> list[Track]:
    from hil.calibration.evaluation import track_all

    if file is not None and deploy == "twist":
        return track_all(recordings, file.nominal_geometry, "exact", signal, file.twist)
    geometry = file.geometry if file is not None else robot.geometry
    return track_all(recordings, geometry, model, signal)


def _doubts(
    recordings: list[Recording],
    file: CalibrationFile | None,
    robot: Nominal,
    signal: str,
    deploy: str,
    contradicted: bool,
) -> list[str]:
    """Reasons to doubt these errors: a geometry that cannot be right, motions that were never fitted."""
    from hil.calibration.cross_validation import deployed
    from hil.calibration.excitation import BENCH_FILE, OTHER_ROBOT, Driven, mismatch
    from hil.calibration.problem import make_setting
    from hil.calibration.warnings import beyond_driven, worse_as_twist
    from hil.datasets.blocks import reduce_recordings

    blocks = reduce_recordings(recordings, _BLOCK_S, signal)
    found = "" if any(one.contradictions for one in recordings) else mismatch(blocks, robot)
    out = [f"{found}; {BENCH_FILE if contradicted else OTHER_ROBOT}"] if found else []
    if file is None:
        return out
    if file.driven_m:
        out += beyond_driven(blocks, robot.geometry, Driven.from_json(file.driven_m))
    if deploy == "twist":
        setting = make_setting("recommended", model=file.model, signal=signal)
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
