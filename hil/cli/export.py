"""`hil export`: a recording as a table, CSV or Parquet, or as trajectories of TUM and KITTI."""

from __future__ import annotations

import json
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from hil.cli.options import FILE, JSON, OUT, TOPICS
from hil.core.errors import EXIT_PASS, EXIT_USAGE, DataError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hil.core.signals import CycleRecord
    from hil.datasets.export import WheelTable


@click.command()
@click.argument("recording", type=FILE)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["csv", "parquet", "tum"]),
    help="tum: a folder with estimate and truth as .tum and .kitti [default: by --out, else csv].",
)
@click.option("--out", type=OUT, help="File or folder to write [default: beside RECORDING].")
@TOPICS
@JSON
def command(recording: Path, kind: str | None, out: Path | None, topics: Path | None, as_json: bool) -> int:
    """Write one row per wheel sample; a damaged recording gives what it has and exit code 2.

    RECORDING is one of ours, or a bag of another robot with --topics: wheels and ground truth, no estimate.
    The newest sample of every device that another package adds is in columns of its name.

    Example: hil export recording.mcap --format csv
    """
    from hil.datasets.export import check_target, write_table

    chosen, target = _target(recording, kind, out, foreign=topics is not None)
    table, problems = _table(recording, topics)
    result = {"recording": str(recording), "out": str(target), "format": chosen, "cycles": table.cycles}
    if chosen == "tum":
        files = _write_trajectories(table, target)
        result["files"] = list(map(str, files))
        said = f"{target}: {', '.join(file.name for file in files)}"
    else:
        check_target(target, chosen)
        write_table(table, target, chosen)
        result |= {"rows": len(table.values), "columns": list(table.columns)}
        said = f"{target}: {len(table.values)} rows of {table.cycles} cycles"
    for problem in problems:
        click.echo(f"hil: {recording}: {problem}", err=True)
    if as_json:
        click.echo(json.dumps({**result, "problems": problems}))
    else:
        click.echo(said, err=_is_stdout(target))  # a line among the rows would be no row
    return EXIT_USAGE if problems else EXIT_PASS


def _target(recording: Path, kind: str | None, out: Path | None, *, foreign: bool) -> tuple[str, Path]:
    """Format, and file or folder to write."""
    from hil.support.atomic_files import check_ending, check_folder

    replayed = f"`hil replay {shlex.quote(str(recording))} --trajectories FOLDER`"
    if out is not None and out.suffix.lower() in (".tum", ".kitti"):
        raise UsageError(
            f"{out}: trajectories are several files, in a folder",
            expected="one that ends with .csv or .parquet, or a folder with --format tum",
            remedy=f"{replayed} writes those of each estimator",
        )
    if kind == "tum":
        if foreign:
            raise UsageError(
                f"{recording}: a bag of another robot has no estimate", remedy=f"{replayed} makes them"
            )
        folder = out or recording.with_name(f"{recording.stem}_trajectories")
        check_folder(folder)
        return kind, folder
    if out is not None and kind is None:
        check_ending(out, ".csv", ".parquet")
    chosen = kind or ("parquet" if out is not None and out.suffix.lower() == ".parquet" else "csv")
    target = out or recording.with_suffix(f".{chosen}")
    check_ending(target, f".{chosen}")
    return chosen, target


def _table(recording: Path, topics: Path | None) -> tuple[WheelTable, list[str]]:
    """Table of a recording, and what of it could not be read."""
    from hil.datasets.export import wheel_table
    from hil.recording.mcap_reader import read_cycles

    problems: list[str] = []
    table = wheel_table(read_cycles(recording, problems) if topics is None else _foreign(recording, topics))
    if not len(table.values):
        why = f" that can be read ({'; '.join(problems)})" if problems else ""
        raise DataError(str(recording), "holds no wheel sample" + why, expected="at least one row")
    return table, problems


def _foreign(recording: Path, topics: Path) -> Iterable[CycleRecord]:
    """Cycles of a recording of another robot."""
    from hil.datasets.as_cycles import to_cycles
    from hil.datasets.mapped_recordings import read_mapped
    from hil.datasets.topic_map import read_topic_map

    found = read_mapped(recording, read_topic_map(topics))
    if found.of_twist:
        raise UsageError(
            f"{recording}: --topics names a twist, and the table is of wheels",
            remedy="write its trajectories with `hil replay --trajectories FOLDER`",
        )
    if found.later:
        raise DataError(
            str(recording),
            "its stamps step back: one table cannot hold both parts",
            expected="stamps that go on",
            remedy="cut the recording there",
        )
    return to_cycles(found, on_wall=False)


def _write_trajectories(table: WheelTable, folder: Path) -> list[Path]:
    """Write estimate and, where there is one, ground truth at the stamps of the wheels; return the files."""
    from hil.datasets.plain_csv import TRUTH_COLUMNS
    from hil.datasets.trajectory_files import write_trajectories

    begins = {"estimate": "estimate_x_m", "truth": TRUTH_COLUMNS[0]}
    paths = {name: table.values[:, table.columns.index(first) :][:, :3] for name, first in begins.items()}
    known = {name: poses for name, poses in paths.items() if np.isfinite(poses).any()}
    return write_trajectories(folder, table.values[:, 0], known)


def _is_stdout(path: Path) -> bool:
    """Whether a path is the standard output of this process, as /dev/stdout."""
    try:
        return os.path.samestat(path.stat(), os.fstat(sys.stdout.fileno()))
    except OSError:
        return False
