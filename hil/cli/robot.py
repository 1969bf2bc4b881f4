"""`hil robot`: shows, compares, applies and rolls back the record of a robot."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.completion_types import BENCH
from hil.cli.options import FILE, JSON, OUT, SuggestingGroup
from hil.core.clock import local_time

if TYPE_CHECKING:
    from hil.config.robot_record import KeptVersion, RecordFile

_RECORD = click.argument("record", type=FILE)


@click.group(cls=SuggestingGroup)
def command() -> None:
    """The record of a robot (a folder): show, compare, apply, roll back. And its URDF."""


@command.command()
@_RECORD
@click.option("--version", type=int, help="Another version than the one in place.")
@click.option("--page", type=FILE, help="Write an HTML page, too.")
@JSON
def show(record: Path, version: int | None, page: Path | None, as_json: bool) -> int:
    """Show what the record knows of the robot, with uncertainty and date, and what is out of date.

    Example: hil robot show robot --page robot.html
    """
    from hil.config.robot_record import RobotRecord
    from hil.report.commission_page import write_robot_page
    from hil.report.robot_table import part_rows
    from hil.support.atomic_files import check_ending

    if page is not None:
        check_ending(page, ".html")
    found = RobotRecord(record)
    file = found.read() if version is None else found.find(version).file
    rows, history = part_rows(file, date.today()), found.history()
    if page is not None:
        write_robot_page(page, found, date.today())
    if as_json:
        reported = {
            "record": str(record),
            "version": file.version,
            "created": file.created,
            "by": file.why,
            "robot": file.robot.model_dump(mode="json", exclude_none=True),
            "parts": rows,
            "confirmed": {key: one.model_dump(mode="json") for key, one in file.confirmed.items()},
            "versions": [_described(v) for v in history.versions],
            "damaged": [{"path": str(path), "why": why} for path, why in history.damaged],
        }
        click.echo(json.dumps(reported, allow_nan=False))
        return 0
    click.echo(f"{file.robot.name}: version {file.version} of {record}, {file.created}, by {file.why}")
    for row in rows:
        click.echo(_line(row))
        for figure in row.get("figures", ()):
            click.echo(f"    {figure['name'].replace('_', ' '):36}{figure['words']}")
    for key, one in file.confirmed.items():
        where = ", ".join(filter(None, (one.procedure, one.bound)))
        click.echo(f"confirmed   {one.measured[:10]}  {key} {one.value} by {one.by} ({where})")
    for path, why in history.damaged:
        click.echo(f"hil: {path}: {why}", err=True)
    return 0


def _line(row: dict[str, Any]) -> str:
    if not row["known"]:
        return f"{row['part']:12}not known: hil run {row['measured_by']}"
    until = "out of date" if row["out_of_date"] else f"until {row['until']}" if row["until"] else "no end"
    on = f", on {row['surface']}" if row["surface"] else ""
    return f"{row['part']:12}{row['since'][:10]}  {row['by']} ({row['verdict']}), {until}{on}: {row['title']}"


@command.command()
@_RECORD
@click.argument("first", type=int, required=False)
@click.argument("second", type=int, required=False)
@JSON
def diff(record: Path, first: int | None, second: int | None, as_json: bool) -> int:
    """Show how two versions differ [default: the one in place and the one before it].

    Example: hil robot diff robot 2 3
    """
    from hil.report.robot_table import differences

    old, new = _two(record, first, second)
    rows = differences(old, new)
    if as_json:
        click.echo(json.dumps({"old": old.version, "new": new.version, "differences": rows}, allow_nan=False))
        return 0
    click.echo(f"version {old.version} ({old.why}) and version {new.version} ({new.why})")
    for row in rows:
        sigmas = "" if row["sigmas"] is None else f"  ({row['sigmas']:+.1f} sigma)"
        click.echo(f"{row['part']:12}{row['name']:36}{row['old']} -> {row['new']}{sigmas}")
    return 0


def _two(record: Path, first: int | None, second: int | None) -> tuple[RecordFile, RecordFile]:
    from hil.config.robot_record import RobotRecord
    from hil.core.errors import ConfigError

    found = RobotRecord(record)
    new = found.read() if second is None else found.find(second).file
    if first is not None:
        return found.find(first).file, new
    earlier = [v.file for v in found.history().versions if v.file.version < new.version]
    if not earlier:
        raise ConfigError(f"{record}: no version before {new.version}", remedy="name two versions")
    return earlier[-1], new


@command.command()
@_RECORD
@click.option("--version", type=int, help="Version of the record to put in place.")
@click.option(
    "--from",
    "source",
    type=FILE,
    help="Take parts from part_NAME.toml, calibration.toml, bench_fragment.toml or another record.",
)
@click.option("--bench", type=BENCH, help="Bench file or profile of the robot; needed with --from.")
@click.option(
    "--of-this-robot", is_flag=True, help="Confirm that a file which names no robot is of this robot."
)
@JSON
def apply(
    record: Path,
    version: int | None,
    source: Path | None,
    bench: str | None,
    of_this_robot: bool,
    as_json: bool,
) -> int:
    """Put a version in place, or take parts from older files as a new version.

    Results of another robot, or of a run that did not pass, are refused.

    Example: hil robot apply robot --from calibration.toml --bench my.toml
    """
    from hil.bench.doctor.robot_record_import import import_record
    from hil.config.loading import load_bench
    from hil.config.robot_record import RobotRecord
    from hil.core.errors import UsageError

    if (version is None) == (source is None):
        raise UsageError("what is to be applied?", expected="either --version N or --from FILE")
    found = RobotRecord(record)
    if version is not None:
        return _done(found.apply(version), as_json)
    if bench is None:
        raise UsageError("whose parts are these?", expected="--bench FILE, the bench of the robot")
    assert source is not None
    config = load_bench(bench)
    import_record(found, source, config, local_time(), of_this_robot=of_this_robot)
    return _done(found.find(found.read().version), as_json)


@command.command()
@_RECORD
@click.option("--version", type=int, help="Version to go back to [default: the one before].")
@JSON
def rollback(record: Path, version: int | None, as_json: bool) -> int:
    """Put an earlier version back in place, also when the one in place is damaged.

    Example: hil robot rollback robot
    """
    from hil.config.robot_record import RobotRecord

    return _done(RobotRecord(record).rollback(version), as_json)


@command.command()
@bench_options("bench", "calibration")
@click.option("--out", type=OUT, help="File to write [default: standard output].")
def urdf(request: BenchRequest, out: Path | None) -> int:
    """Write the URDF of a bench's robot for ROS and Foxglove; its joints take the angles of /joint_states.

    Example: hil robot urdf --bench my.toml --out robot.urdf
    """
    from hil.bench import make_bench_model
    from hil.recording.urdf import urdf as described
    from hil.support.atomic_files import write_text

    text = described(make_bench_model(request.bench, calibration=request.calibration).header())
    if out is None:
        click.echo(text, nl=False)
    else:
        write_text(out, text)
    return 0


def _done(kept: KeptVersion, as_json: bool) -> int:
    row = _described(kept) | {"in_place": True}
    words = f"version {row['version']} is in place: {', '.join(row['parts'])} ({row['created']}, {row['by']})"
    click.echo(json.dumps(row) if as_json else words)
    return 0


def _described(kept: KeptVersion) -> dict[str, Any]:
    file = kept.file
    return {
        "version": file.version,
        "created": file.created,
        "by": file.why,
        "parts": list(file.parts),
        "in_place": kept.in_place,
        "path": str(kept.path),
        "sha256": file.sha256,
    }
