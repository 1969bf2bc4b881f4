"""`hil replay`: re-run estimation on a recording, or verify that what it decided repeats."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from hil.cli.closed_output import error_as_json
from hil.cli.completion_types import BENCH
from hil.cli.options import (
    COUPLING,
    FILE,
    JSON,
    TOPICS,
    FiniteRange,
    rerun_option,
    say_rerun_files,
    truth_options,
)
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, EXIT_USAGE, DataError, UsageError
from hil.core.known_names import ALIGNMENTS, COMPARED

if TYPE_CHECKING:
    from hil.bench.pipelines import BenchModel
    from hil.datasets.azimuth_coupling import Coupling
    from hil.datasets.truth_files import TruthFile
    from hil.loop.driven_motion import Motion
    from hil.recording.runs import RecordedRun
    from hil.replay.recordings import OpenedRecording

_PATH_POINTS = 400
_RELATIVE = (("rpe_position_m", "rpe mm", 1e3), ("rpe_theta_rad", "rpe deg", math.degrees(1.0)))
_COLUMNS = (
    ("rmse_position_m", "rmse mm", 1e3),
    ("rmse_theta_rad", "rmse deg", math.degrees(1.0)),
    ("final_position_m", "end mm", 1e3),
    ("max_position_m", "worst mm", 1e3),
    ("nees_pose", "NEES", 1.0),
    ("nis_wheels", "NIS wheel", 1.0),
    ("nis_gyro", "NIS gyro", 1.0),
    ("nis_tracker", "NIS cam", 1.0),
    ("rejected_tracker", "cam. out", 1.0),
)


@click.command()
@click.argument("recording", type=FILE)
@click.option(
    "--estimator",
    "estimators",
    metavar=f"{'|'.join(COMPARED)}|FILE.py:NAME",
    multiple=True,
    help="Estimator to run on the recorded measurements (repeatable); your own is a class in a Python file "
    "[default: the four that are shipped].",
)
@click.option(
    "--verify",
    is_flag=True,
    help="Decide on the recorded inputs again and compare: every bit where the arithmetic is that of the "
    "recording, else within stated limits. Exit 1 if it differs, 2 if the recording is damaged.",
)
@click.option(
    "--run",
    "number",
    type=click.IntRange(min=0),
    help="Which run of the recording, from 0 [default: all to verify, the longest to compare].",
)
@click.option(
    "--bench", type=BENCH, help="Bench file or profile, for recordings that do not carry their own."
)
@click.option("--calibration", type=FILE, help="calibration.toml for the estimators.")
@TOPICS
@truth_options
@COUPLING
@click.option(
    "--align",
    type=click.Choice(ALIGNMENTS),
    default="none",
    show_default=True,
    help="Alignment of each estimate to the ground truth before its errors: the first pose (yaw and "
    "position), or the best motion of the plane (SE(2)).",
)
@click.option(
    "--rpe-over",
    "over_m",
    type=FiniteRange(min=0.0, min_open=True),
    help="Show relative pose errors over this way, m [default: 0.1, in the JSON alone].",
)
@click.option(
    "--trajectories",
    type=FILE,
    help="Folder for the truth and each estimate at the same instants, as TUM and KITTI files.",
)
@click.option("--page", type=FILE, help="HTML page with figures.")
@rerun_option("Show it: spawn, connect, serve, a rerun+http:// URL or a .rrd file.")
@JSON
def command(
    recording: Path,
    estimators: tuple[str, ...],
    verify: bool,
    number: int | None,
    bench: str | None,
    calibration: Path | None,
    topics: Path | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    align: str,
    over_m: float | None,
    trajectories: Path | None,
    page: Path | None,
    view: str | None,
    as_json: bool,
) -> int:
    """Re-run estimation on a recording; with --verify, compare every decision with the recorded one.

    --verify says `identical`, `agrees` (computed by another arithmetic, as on another processor: the largest
    differences are shown beside their limits) or `differs` (the first cycle and field).

    RECORDING is one of ours (.mcap), a bag of another robot with --topics, half of a public CSV pair,
    or plain CSV; --topics new prints a draft of the mapping of a bag.
    A damaged recording gives what it has and ends with exit code 2, as
    does a page or a --rerun file that the disk did not take, or a viewer that did not take everything.

    Example: hil replay recording.mcap --page replay.html --estimator ekf --estimator mine.py:MyFilter
    """
    from hil.core.signals import sensors_with_samples
    from hil.datasets.topic_draft import draft
    from hil.datasets.trajectory_files import write_trajectories
    from hil.replay.estimator_comparison import sensors_text
    from hil.replay.estimator_states import unknown_states, unusable_states
    from hil.replay.recordings import open_recording
    from hil.replay.truth_errors import RELATIVE_M, paths_of
    from hil.support.atomic_files import check_ending, check_file, check_folder
    from hil.user_code.roles import ESTIMATOR

    for named in estimators:
        ESTIMATOR.check(named)
    if page is not None:
        check_ending(page, ".html")
        check_file(page)
    if topics == Path("new"):
        click.echo(json.dumps({"topics": draft(recording)}) if as_json else draft(recording), nl=as_json)
        return EXIT_PASS
    opened = open_recording(
        recording, bench=bench, calibration=calibration, topics=topics, truth=truth, coupling=coupling
    )
    if trajectories is not None:
        check_folder(trajectories)
    result: dict[str, Any] = {"recording": str(recording)}
    unshown = ""
    if verify:
        others = (view, calibration, trajectories)
        if estimators or any(one is not None for one in others):
            raise UsageError("--verify cannot go with --estimator, --calibration, --trajectories or --rerun")
        result |= _verified(opened, number)
        result["problems"] = opened.problems
        if page is not None:
            _write(result, lambda: _write_verification(page, opened, result))
    else:
        run = opened.run(number)
        result["cycles"] = sum(opened.lengths) if number is None else len(run.records)
        sensors = sensors_with_samples(r.measurements for r in run.records)
        result["sensors"], result["note"] = sensors, sensors_text(opened.bench, sensors)
        slip, over = opened.slip, over_m or RELATIVE_M
        result |= {} if slip is None else {"slip": slip.to_json()}
        motions, result["estimators"] = _compared(opened, run, estimators or COMPARED, align, over)
        result |= {"align": align, "rpe_over_m": over}
        unknown = (line for name in estimators for line in unknown_states(name, motions[name]))
        result["warnings"] = [*opened.warnings(), *unknown]
        for line in result["warnings"]:
            click.echo(f"warning: {line}", err=True)
        unusable = (line for name in estimators for line in unusable_states(name, motions[name]))
        result["problems"] = [*opened.problems, *opened.contradicted, *unusable]
        if trajectories is not None:
            result["trajectories"] = list(map(str, write_trajectories(trajectories, *paths_of(motions))))
        unshown = _show(opened.bench, run, motions, view)
        if page is not None:
            _write(result, lambda: _write_page(page, opened, motions, result))
    for problem in result["problems"]:
        click.echo(f"hil: {recording}: {problem}", err=True)
    click.echo(json.dumps(result) if as_json else _text(result, () if over_m is None else _RELATIVE))
    if result["problems"] or unshown or "error" in result:
        return EXIT_USAGE
    return EXIT_LIMIT_FAILED if result.get("verdict") == "differs" else EXIT_PASS


def _write(result: dict[str, Any], write: Callable[[], object]) -> None:
    """Write a page; if that fails, the figures of the replay are kept."""
    try:
        write()
    except DataError as error:
        click.echo(f"hil: {error}", err=True)
        result["error"] = error_as_json(error)


def _verified(opened: OpenedRecording, number: int | None) -> dict[str, Any]:
    from hil.replay.verification import verify_recording

    found = verify_recording(opened, number)
    now, then = opened.bench.versions(), opened.header.get("versions", {})
    changed = {k: [v, now.get(k, "absent")] for k, v in then.items() if now.get(k, "absent") != v}
    return {**found, "cycles": sum(r["cycles"] for r in found["runs"]), "changed_versions": changed}


def _compared(
    opened: OpenedRecording, run: RecordedRun, named: tuple[str, ...], align: str, over_m: float
) -> tuple[dict[str, Motion], dict[str, dict[str, float | None]]]:
    from hil.replay.estimator_comparison import compare_run, table
    from hil.user_code.roles import ESTIMATOR

    kinds = [name for name in named if name in COMPARED]
    own = {name: ESTIMATOR.make(name, opened.bench) for name in named if name not in COMPARED}
    motions = compare_run(
        run, opened.bench, kinds, own=own, source=str(opened.path), recorded=not opened.foreign
    )
    return motions, table(motions, align, over_m)


def _write_page(
    page: Path, opened: OpenedRecording, motions: dict[str, Motion], result: dict[str, Any]
) -> None:
    from hil.replay.estimator_comparison import truth_of
    from hil.report.replay_page import write_replay_page

    write_replay_page(
        page,
        f"Replay of {opened.path.name}",
        motions,
        truth_of(next(iter(motions.values()))),
        result["estimators"],
        [*result["problems"], *result["warnings"]],
        (result["note"],),
        on_wall=opened.bench.config.environment.on_wall,
    )


def _write_verification(page: Path, opened: OpenedRecording, result: dict[str, Any]) -> None:
    from hil.report.replay_page import write_verification_page

    write_verification_page(page, f"Replay of {opened.path.name}, verified", result, opened.problems)


def _show(bench: BenchModel, run: RecordedRun, motions: dict[str, Motion], view: str | None) -> str:
    """Show the run in the monitor, other estimators as further paths; returns what failed there."""
    if view is None:
        return ""
    from hil.monitor import RerunMonitor, Scene
    from hil.replay.estimator_comparison import beside

    scene = Scene.of(bench.config, bench.geometry, recorded=True)
    monitor = RerunMonitor(view, lossless=True, scene=scene)
    planned = [r.reference.pose_in_wall[:2] for r in run.records if r.reference is not None]
    if planned:
        monitor.show_path(np.array(planned[:: max(1, len(planned) // _PATH_POINTS)]))
    for record in beside(motions):
        monitor.write(record)
    monitor.close()
    say_rerun_files(view)
    return monitor.failure


def _text(result: dict[str, Any], more: tuple[tuple[str, str, float], ...]) -> str:
    from hil.support.file_reading import printable

    if "verdict" in result:
        return _verification_text(result)
    columns = (*_COLUMNS, *more)
    head = " ".join(f"{title:>9}" for _, title, _ in columns)
    width = max(12, *map(len, result["estimators"]))
    lines = [f"{'estimator':{width}} {head}"]
    for name, e in result["estimators"].items():
        cells = (("-" if e[key] is None else f"{e[key] * factor:.3f}") for key, _, factor in columns)
        lines.append(f"{printable(name):{width}} " + " ".join(f"{cell:>9}" for cell in cells))
    lines.append(result["note"])
    if slip := result.get("slip"):
        shown = (
            f"{name} {one['factor']:.4f} +- {one['sigma']:.4f}" if one else f"{name} not determined"
            for name, one in slip["factors"].items()
        )
        lines.append(f"way by {slip['by']} over that of the twist: {', '.join(shown)}")
    return "\n".join(lines)


def _verification_text(result: dict[str, Any]) -> str:
    from hil.support.arithmetic_fingerprint import differences
    from hil.support.file_reading import printable

    words = {"identical": "identical in ", "agrees": "agrees within the limits in "}
    lines = [
        f"run {r['run']}: {r['cycles']} cycles, "
        + (r["difference"] or words[r["verdict"]] + ", ".join(r["verified"]))
        for r in result["runs"]
    ]
    then, here = result["recorded_with"], result["verified_with"]
    if result["verdict"] != "identical" and then != here:
        lines += [f"{'quantity':18} {'largest difference':>18}  limit"]
        for name, value in result["largest"].items():
            limit = result["limits"][name]
            lines.append(f"{name:18} {value:18.2g}  {limit['value']:g} {limit['unit']}")
    if not then:
        lines.append("the recording does not say by what arithmetic it was made")
    else:
        pairs = differences(then, here).items()
        lines += [f"other arithmetic: {key} was {one}, here {other}" for key, (one, other) in pairs]
    lines += [f"remark: {r['remark']}" for r in result["runs"] if "remark" in r]
    changed = dict(result["changed_versions"])
    if changed.pop("hil_sources", None):
        lines.append("this package's own source code has changed since the recording")
    lines += [f"recorded with {k} {old}, now {new}" for k, (old, new) in changed.items()]
    return printable("\n".join([f"verdict: {result['verdict']}", *lines]))
