"""`hil replay`: re-run estimation on a recording, or prove that it repeats bit for bit."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.errors import EXIT_LIMIT_FAILED, EXIT_PASS, EXIT_USAGE, DataError

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.motion import Motion
    from hil.recording.runs import RecordedRun

_KINDS = ("odometry", "ekf", "ukf")


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--estimator", "estimators", type=click.Choice(_KINDS), multiple=True,
    help="Estimator to run on the recorded measurements (repeatable) [default: all three].",
)  # fmt: skip
@click.option(
    "--verify", is_flag=True, help="Hold every recomputed bit against the recording; exit 1 if not."
)
@click.option("--page", type=click.Path(path_type=Path), help="HTML page with figures.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    recording: Path, estimators: tuple[str, ...], verify: bool, page: Path | None, as_json: bool
) -> int:
    """Re-run estimation on a recording; with --verify, name the first cycle and field that differ."""
    from hil.recording.mcap_reader import read_header
    from hil.recording.runs import read_runs

    problems: list[str] = []
    bench = _bench(recording, read_header(recording))
    runs = list(read_runs(recording, problems))
    if not runs:
        raise DataError(str(recording), "holds no cycles")
    result: dict[str, Any] = {"recording": str(recording), "cycles": sum(len(r.records) for r in runs)}
    if verify:
        result["runs"] = [_verified(bench, run) for run in runs]
        result["identical"] = all(r["difference"] is None for r in result["runs"])
    else:
        motions = _compared(recording, bench, max(runs, key=lambda r: len(r.records)), estimators or _KINDS)
        result["estimators"] = _table(motions)
        if page is not None:
            from hil.report.replay_page import write_replay_page

            write_replay_page(page, f"Replay of {recording.name}", motions, tuple(problems))
    result["problems"] = problems
    for problem in problems:
        click.echo(f"hil: {recording}: {problem}", err=True)
    click.echo(json.dumps(result) if as_json else _text(result))
    if verify and not result["identical"]:
        return EXIT_LIMIT_FAILED
    return EXIT_USAGE if problems else EXIT_PASS


def _bench(recording: Path, header: dict[str, Any]) -> Bench:
    """The bench of a recording without its devices."""
    from hil.bench import Bench, alignment_parameters
    from hil.clock import MonotonicClock
    from hil.config.bench import validate
    from hil.kinematics import WheelGeometry
    from hil.rig import Rig

    if "config" not in header:
        raise DataError(str(recording), "does not carry the configuration of its bench")
    config = validate(header["config"], f"configuration in {recording}")
    clock = MonotonicClock()
    geometry = header.get("geometry")
    return Bench(
        config,
        clock,
        Rig(clock),
        world=None,
        geometry=WheelGeometry.nominal() if geometry is None else WheelGeometry.from_vector(geometry),
        alignment=alignment_parameters(config),
        seed=int(header.get("seed", 0)),
    )


def _verified(bench: Bench, run: RecordedRun) -> dict[str, Any]:
    from hil.report.replay import ESTIMATION, FIELDS, RecordedReferences, verify

    told: dict[str, Any] = {"cycles": len(run.records), "verified": [], "difference": None}
    if run.start is None:
        return told | {"difference": "the recording does not say how this run began"}
    brain = bench.make_brain(None, feedback=run.start.feedback, observers=run.start.observers)
    if run.records[0].reference is not None:
        brain.reference_at = RecordedReferences(run.records)
    fields = FIELDS if run.start.controller is None else ESTIMATION
    found = verify(run.records, brain, run.start.state, fields)
    told["verified"] = list(fields)
    if found is not None:
        told["difference"] = f"cycle {found.cycle}: {found.field}"
    return told


def _compared(recording: Path, bench: Bench, run: RecordedRun, kinds: tuple[str, ...]) -> dict[str, Motion]:
    from hil.report.replay import compare

    if run.start is None:
        raise DataError(str(recording), "does not say how its run began")
    estimators = {kind: bench.make_brain(None, feedback=kind).estimator for kind in kinds}
    return compare(run.records, estimators, run.start.state)


def _table(motions: dict[str, Motion]) -> dict[str, dict[str, float | None]]:
    from hil.report.replay import errors

    return {
        name: {key: value if math.isfinite(value) else None for key, value in errors(motion).items()}
        for name, motion in motions.items()
    }


def _text(result: dict[str, Any]) -> str:
    if "runs" in result:
        lines = [
            f"run {i}: {r['cycles']} cycles, {r['difference'] or 'identical in ' + ', '.join(r['verified'])}"
            for i, r in enumerate(result["runs"])
        ]
        return "\n".join(lines)
    lines = [f"{'estimator':12} {'rmse mm':>9} {'rmse deg':>9} {'end mm':>9} {'worst mm':>9}"]
    for name, e in result["estimators"].items():
        scaled = zip(e.values(), (1e3, math.degrees(1.0), 1e3, 1e3), strict=True)
        lines.append(
            f"{name:12} " + " ".join(f"{'-' if v is None else f'{v * k:.3f}':>9}" for v, k in scaled)
        )
    return "\n".join(lines)
