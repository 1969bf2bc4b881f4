"""`hil report`: the HTML page of a run, or a comparison of several runs or of two campaigns."""

import json
from pathlib import Path

import click

from hil.cli.completion_types import RESULTS
from hil.cli.options import JSON, OUT
from hil.core.errors import shown_path
from hil.core.result_names import COMPARISON


@click.command()
@click.argument("folders", nargs=-1, required=True, type=RESULTS)
@click.option("--out", type=OUT, help="Where to write the page [default: in the folder].")
@JSON
def command(folders: tuple[Path, ...], out: Path | None, as_json: bool) -> int:
    """Write the report of a results folder; with several folders, compare their runs.

    Two folders of campaigns are compared case by case, with the same seeds and settings as pairs.

    Example: hil report out/bring_up/first out/bring_up/second
    """
    from hil.report.compare_campaigns import is_campaign
    from hil.report.compare_page import compare, comparison_text, write_compare_page
    from hil.report.result_reader import own_file, read_result
    from hil.report.run_page import write_run_page
    from hil.support.file_reading import printable

    if len(folders) == 1:
        page = write_run_page(folders[0], out)
        tree = read_result(folders[0])
        found = {"report": str(page), "procedure": tree["procedure"], "verdict": tree["verdict"]}
        click.echo(json.dumps(found) if as_json else printable(f"{tree['verdict']}: {shown_path(page)}"))
        return 0
    page = out if out is not None else own_file(folders[0], COMPARISON)
    if any(map(is_campaign, folders)):
        return _campaigns(folders, page, as_json)
    table = compare(folders)
    write_compare_page(page, table)
    click.echo(json.dumps({**table, "report": str(page)}) if as_json else printable(comparison_text(table)))
    if not as_json:
        click.echo(f"page: {shown_path(page)}")
    return 0


def _campaigns(folders: tuple[Path, ...], page: Path, as_json: bool) -> int:
    """Compare two campaigns."""
    from hil.core.errors import UsageError
    from hil.report.compare_campaigns import campaigns_text, compare_campaigns, write_campaigns_page
    from hil.support.file_reading import printable

    if len(folders) != 2:
        raise UsageError(f"{len(folders)} campaigns to compare", expected="two of them")
    table = compare_campaigns(*folders)
    write_campaigns_page(page, table)
    click.echo(json.dumps({**table, "report": str(page)}) if as_json else printable(campaigns_text(table)))
    if not as_json:
        click.echo(f"page: {shown_path(page)}")
    return 0
