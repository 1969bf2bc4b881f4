"""`hil export`: a recording as CSV or Parquet."""

import json
import os
import shlex
import sys
from pathlib import Path

import click

from hil.cli.options import FILE, JSON, OUT, TOPICS
from hil.core.errors import EXIT_PASS, EXIT_USAGE, DataError, UsageError


@click.command()
@click.argument("recording", type=FILE)
@click.option("--format", "kind", type=click.Choice(["csv", "parquet"]), help="Default: by --out, else csv.")
@click.option("--out", type=OUT, help="File to write [default: beside RECORDING].")
@TOPICS
@JSON
def command(recording: Path, kind: str | None, out: Path | None, topics: Path | None, as_json: bool) -> int:
    """Write one row per wheel sample; a damaged recording gives what it has and exit code 2.

    RECORDING is one of ours, or a bag of another robot with --topics: wheels and ground truth, no estimate.
    The newest sample of every device that another package adds is in columns of its name.

    Example: hil export recording.mcap --format csv
    """
    from hil.datasets.export import check_target, wheel_table, write_table
    from hil.recording.mcap_reader import read_cycles
    from hil.support.atomic_files import check_ending

    if out is not None and out.suffix.lower() in (".tum", ".kitti"):
        raise UsageError(
            f"{out}: is a trajectory, and the table is of wheels",
            expected="one that ends with .csv or .parquet",
            remedy=f"`hil replay {shlex.quote(str(recording))} --trajectories FOLDER` writes .tum and .kitti",
        )
    if out is not None and kind is None:
        check_ending(out, ".csv", ".parquet")
    chosen = kind or ("parquet" if out is not None and out.suffix.lower() == ".parquet" else "csv")
    target = out or recording.with_suffix(f".{chosen}")
    check_ending(target, f".{chosen}")
    problems: list[str] = []
    if topics is None:
        table = wheel_table(read_cycles(recording, problems))
    else:
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
        table = wheel_table(to_cycles(found, on_wall=False))
    if not len(table.values):
        why = f" that can be read ({'; '.join(problems)})" if problems else ""
        raise DataError(str(recording), "holds no wheel sample" + why, expected="at least one row")
    check_target(target, chosen)
    write_table(table, target, chosen)
    for problem in problems:
        click.echo(f"hil: {recording}: {problem}", err=True)
    if as_json:
        result = {
            "recording": str(recording),
            "out": str(target),
            "format": chosen,
            "cycles": table.cycles,
            "rows": len(table.values),
            "columns": list(table.columns),
            "problems": problems,
        }
        click.echo(json.dumps(result))
    else:
        said = f"{target}: {len(table.values)} rows of {table.cycles} cycles"
        click.echo(said, err=_is_stdout(target))  # a line among the rows would be no row
    return EXIT_USAGE if problems else EXIT_PASS


def _is_stdout(path: Path) -> bool:
    """Whether a path is the standard output of this process, as /dev/stdout."""
    try:
        return os.path.samestat(path.stat(), os.fstat(sys.stdout.fileno()))
    except OSError:
        return False
