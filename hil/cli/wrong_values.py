"""`hil faults --configuration`: one wrong number in the bench file after another, judged by what is true."""

import json
from collections.abc import Sequence
from pathlib import Path

import click

from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, UsageError, shown_path
from hil.core.result_names import WRONG_VALUES_TABLE
from hil.support.atomic_files import check_file


def run_wrong_values(
    *,
    plants: Sequence[str],
    seeds: Sequence[int],
    quick: bool,
    only: Sequence[str],
    workers: int,
    out: Path,
    as_json: bool,
) -> int:
    """Run the campaign of wrong values; returns the exit code, 1 for a wrong value that stayed silent.

    Args:
        plants: physics models.
        seeds: seeds of the worlds.
        quick: True for one mistake in each parameter.
        only: keys of the bench file, or names of its tables; empty for all.
        workers: number of processes; 0 runs here.
        out: folder of the table.
        as_json: True for JSON on stdout.
    """
    from hil.campaign import spread
    from hil.fault_matrix.wrong_values import Verdict, cases_of, judged, lost, summary, write_pages

    cases = [
        case for key in only or ("",) for case in cases_of(plants=plants, seeds=seeds, quick=quick, only=key)
    ]
    table = out / WRONG_VALUES_TABLE
    check_file(table)
    out.mkdir(parents=True, exist_ok=True)
    found: list[Verdict] = []
    with reporting() as report:

        def done(verdict: Verdict) -> None:
            found.append(verdict)
            if verdict.outcome == "silent":
                click.echo(f"SILENT {verdict.case.name}: {verdict.what}", err=True)
            report("wrong values", len(found), len(cases))

        spread(judged, cases, lost=lost, done=done, workers=workers)
    verdicts = sorted(found, key=lambda verdict: cases.index(verdict.case))
    write_pages(verdicts, table)
    result = summary(verdicts, table)
    if as_json:
        click.echo(json.dumps(result, allow_nan=False))
    else:
        counts = ", ".join(
            f"{result[name]} {name}" for name in ("right", "misnamed", "harmless", "unconfirmed")
        )
        click.echo(
            f"{len(verdicts)} wrong values: {counts}, {len(result['silent'])} silent; {shown_path(table)}"
        )
    return EXIT_LIMIT_FAILED if result["silent"] else EXIT_PASS


def refuse_others(given: dict[str, bool]) -> None:
    """Refuse options that have no meaning with `--configuration`; raises `UsageError`.

    Args:
        given: option names, and True for those that were given.
    """
    if others := [name for name, there in given.items() if there]:
        raise UsageError(
            f"--configuration takes no {', '.join(others)}",
            expected="--quick, --only KEY, --seeds, --plants, --workers, --out, --json",
            remedy="leave them out; it runs on the shipped bench",
        )
