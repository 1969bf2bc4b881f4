"""`hil export`: a recording as CSV or Parquet."""

from __future__ import annotations

import json
from pathlib import Path

import click

from hil.errors import EXIT_PASS, EXIT_USAGE


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(["csv", "parquet"]), help="Default: by --out, else csv.")
@click.option("--out", type=click.Path(path_type=Path), help="File to write [default: beside RECORDING].")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(recording: Path, kind: str | None, out: Path | None, as_json: bool) -> int:
    """Write one row per wheel sample; a damaged recording gives what it has and exit code 2."""
    from hil.recording.export import COLUMNS, write_table
    from hil.recording.mcap_reader import read_cycles

    chosen = kind or ("parquet" if out is not None and out.suffix == ".parquet" else "csv")
    target = out or recording.with_suffix(f".{chosen}")
    problems: list[str] = []
    records = list(read_cycles(recording, problems))
    rows = write_table(records, target, chosen)
    for problem in problems:
        click.echo(f"hil: {recording}: {problem}", err=True)
    if as_json:
        result = {
            "recording": str(recording), "out": str(target), "format": chosen, "cycles": len(records),
            "rows": rows, "columns": list(COLUMNS), "problems": problems,
        }  # fmt: skip
        click.echo(json.dumps(result))
    else:
        click.echo(f"{target}: {rows} rows of {len(records)} cycles")
    return EXIT_USAGE if problems else EXIT_PASS
