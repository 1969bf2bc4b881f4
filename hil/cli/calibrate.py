"""`hil calibrate`: fit the odometry parameters to recordings and validate the result."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.nominal_robot_option import BENCH, configured, on_paper
from hil.cli.options import COUPLING, JSON, OUT, PLOTS, SEED, TOPICS, FiniteRange, truth_options
from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, EXIT_USAGE, UsageError
from hil.core.known_names import METHODS
from hil.core.signals import WHEELS
from hil.robot.kinematics import MODELS

if TYPE_CHECKING:
    from hil.calibration.calibrate import Calibration
    from hil.config.bench import BenchConfig
    from hil.datasets.azimuth_coupling import Coupling
    from hil.datasets.truth_files import TruthFile


@click.command()
@click.argument("data", nargs=-1, required=True)
@click.option("--method", type=click.Choice(METHODS), default="lm", show_default=True)
@click.option(
    "--setting", type=click.Choice(["recommended", "paper"]), default="recommended", show_default=True
)
@click.option("--model", type=click.Choice(MODELS), help="Forward model [default: the setting's].")
@click.option(
    "--signal", type=click.Choice(["position", "velocity"]), help="Wheel signal [default: the setting's]."
)
@click.option(
    "--bounds",
    type=FiniteRange(0.0, 0.2, min_open=True),
    help="Hard bounds instead of the prior: share of a length, rad of a zero, e.g. 0.05.",
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the stochastic methods.")
@click.option("--accept-worse", is_flag=True, help="Write a result that is worse than nominal odometry.")
@click.option("--no-validation", is_flag=True, help="Skip the cross-validations.")
@BENCH
@click.option("--out", type=OUT, help="Write calibration.toml here.")
@TOPICS
@truth_options
@COUPLING
@PLOTS
@JSON
def command(
    data: tuple[str, ...],
    method: str,
    setting: str,
    model: str | None,
    signal: str | None,
    bounds: float | None,
    seed: int,
    accept_worse: bool,
    no_validation: bool,
    bench: str | None,
    out: Path | None,
    topics: Path | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    plots: Path | None,
    as_json: bool,
) -> int:
    """Calibrate the odometry on recordings with ground truth.

    A result that does not explain the recordings, or that is worse than nominal odometry on recordings that
    the fit has not seen, is not written, and the exit code is 1. Corrupt recordings
    are named and left out, as are those that cannot be read. Where they are half of the set, or every one of
    a kind of motion, the set is refused with exit code 2. With a damaged recording, used as far as it can be
    read, nothing is written, and the exit code is 2.

    Example: hil calibrate recordings/ --out calibration.toml
    """
    from hil.calibration.calibrate import calibrate
    from hil.calibration.problem import make_setting
    from hil.core.clock import MonotonicClock
    from hil.datasets.read import read_recordings
    from hil.datasets.topic_map import read_topic_map

    chosen = make_setting(setting, model=model, signal=signal, bounds=bounds)
    config = configured(bench)
    robot = on_paper(config)
    _check_outputs(out, plots)
    if topics is not None and read_topic_map(topics).odometry is not None:
        raise UsageError(f"{topics} names a twist, and no wheels that could be calibrated")
    unusable: dict[str, str] = {}
    with reporting() as report:
        progress = partial(report, "reading")
        recordings = read_recordings(
            data, progress, topics=topics, nominal=robot, truth=truth, coupling=coupling, unusable=unusable
        )
        result = calibrate(
            recordings,
            chosen,
            MonotonicClock(),
            method=method,
            seed=seed,
            nominal=robot,
            validate=not no_validation,
            unusable=unusable,
            report=report,
        )
    failed = result.failure or _worse(result, accept_worse)
    _write(result, failed, out, plots, config)
    click.echo(json.dumps(result.to_json(), allow_nan=False) if as_json else _text(result))
    if any(one.problems for one in result.recordings):
        return EXIT_USAGE
    return EXIT_LIMIT_FAILED if failed else EXIT_PASS


def _worse(result: Calibration, accept_worse: bool) -> str:
    """What a result that is worse than nominal odometry is not written for; empty where it may be."""
    if result.compared.worse and not accept_worse:
        return f"{result.compared.in_words()}; --accept-worse writes it all the same"
    return ""


def _check_outputs(out: Path | None, plots: Path | None) -> None:
    """Refuse output paths that cannot be written, before the work begins."""
    from hil.calibration.calibration_file import next_version
    from hil.support.atomic_files import check_file, check_folder

    if out is not None:
        check_file(out)
        next_version(out)
    if plots is not None:
        check_folder(plots)


def _write(
    result: Calibration, failed: str, out: Path | None, plots: Path | None, config: BenchConfig | None
) -> None:
    """Print the warnings; write the calibration, unless it failed, and its page."""
    for line in result.warnings:
        click.echo(f"warning: {line}", err=True)
    if failed:
        click.echo(f"warning: {out or 'a calibration file'} is not written: {failed}", err=True)
    elif out is not None:
        _write_file(out, result, config)
    if plots is not None:
        from hil.report.calibration_page import write_calibration_page

        click.echo(f"page: {write_calibration_page(plots, result)}", err=True)


def _write_file(out: Path, result: Calibration, config: BenchConfig | None) -> None:
    import numpy as np

    from hil import __version__
    from hil.calibration.calibration_file import write_calibration
    from hil.calibration.usability_check import made_for
    from hil.config.robot_record.overlay import identity

    created = datetime.now(timezone.utc).isoformat(timespec="seconds")
    file = write_calibration(
        out,
        result,
        created=created,
        software={"hil": __version__, "numpy": np.__version__},
        made_for=None if config is None else made_for(config),
        robot=None if config is None else identity(config),
    )
    click.echo(f"wrote {out} (version {file.version})", err=True)


def _left_out(result: Calibration) -> list[str]:
    return [f"left out, and why in a warning: {', '.join(result.rejected)}"] if result.rejected else []


def _spread(result: Calibration) -> str:
    if len(result.recordings) == 1:
        return "no standard errors from one recording: repeat the motion"
    if math.isnan(result.intervals.std[0]):
        return "no standard errors: every parameter is at its bound"
    std = result.intervals.std
    lengths = ", ".join(f"{1e3 * s:.2f}" for s in std[:12])
    zeros = ", ".join(f"{math.degrees(s):.2f}" for s in std[12:])
    return f"standard errors of x, y, r (mm): {lengths}" + (f"; of delta0 (deg): {zeros}" if zeros else "")


def _text(result: Calibration) -> str:
    z = result.geometry
    spectrum = result.spectrum
    lines = [
        f"{result.method}, setting {result.setting.name} ({result.setting.model}, {result.setting.signal}), "
        f"{len(result.recordings)} recordings: J {result.cost_before:.2f} -> {result.cost_after:.2f} "
        f"in {result.wall_s:.2f} s",
        f"from {result.robot.in_words()}",
        *result.choice_in_words(),
        *_left_out(result),
        f"{'wheel':8}{'x_w mm':>10}{'y_w mm':>10}{'r mm':>10}{'delta0 deg':>12}   (effective values)",
    ]
    for i, wheel in enumerate(WHEELS):
        lines.append(
            f"{wheel:8}{z.x_m[i] * 1e3:10.2f}{z.y_m[i] * 1e3:10.2f}{z.radius_m[i] * 1e3:10.3f}"
            f"{math.degrees(z.steering_zero_rad[i]):12.3f}"
        )
    lines.append(_spread(result))
    lines.append("singular values: " + " ".join(f"{v:.3g}" for v in spectrum.singular_values))
    lines.append(
        f"the data determine {spectrum.determined} directions of {len(result.fit.solution.z)} parameters, "
        f"{spectrum.determined_without_contact_law} of them without a law of contact:"
    )
    lines += [f"  {words}" for words in spectrum.directions]
    lines.append(result.compared.in_words())
    if result.validation:
        lines.append(f"{'position RMSE mm / heading RMSE deg':36}{'mean':>15}{'worst motion':>15}")
    for name, table in result.validation.items():
        motions = {motion: row for motion, row in table.items() if motion != "mean"}
        worst = max(motions, key=lambda motion: motions[motion]["rmse_position_m"])
        cells = "".join(f"{_errors(row):>15}" for row in (table["mean"], motions[worst]))
        lines.append(f"{name.replace('_', ' '):36}{cells}  {worst}")
    return "\n".join(lines)


def _errors(row: Mapping[str, float]) -> str:
    """Errors of one motion, or of the mean of all, in mm and deg."""
    return f"{1e3 * row['rmse_position_m']:.1f} /{math.degrees(row['rmse_theta_rad']):6.2f}"
