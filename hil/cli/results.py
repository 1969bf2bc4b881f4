"""`hil results`: lists, opens, searches and follows over time the results of earlier runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion_types import PROCEDURE, RUN
from hil.cli.options import FILE, JSON, OUT, SuggestingGroup
from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, shown_path
from hil.core.result_names import TRENDS

if TYPE_CHECKING:
    from hil.report.history.index import Kept

_COLOURS = {"PASS": "green", "MARGINAL": "yellow", "FAIL": "red", "ERROR": "red", "ABORTED": "magenta"}
_KEY_ROWS = 2

_IN = click.option(
    "--in", "where", type=FILE, default=Path("out"), show_default=True, help="Folder of results."
)
_PROCEDURE = click.option("--procedure", type=PROCEDURE, default="", help="Only runs of this procedure.")
_BENCH = click.option("--bench", default="", help="Only runs on the bench of this name.")


def _verdict(ctx: click.Context, parameter: click.Parameter, value: str) -> str:
    if value and value.upper() not in _COLOURS:
        raise click.BadParameter(f"{value!r} is no verdict; expected {', '.join(_COLOURS)}", ctx, parameter)
    return value


def _day(ctx: click.Context, parameter: click.Parameter, value: str | None) -> datetime | None:
    """The beginning of a day in local time."""
    try:
        return None if value is None else datetime.strptime(value, "%Y-%m-%d").astimezone()
    except (ValueError, OverflowError):
        raise click.BadParameter(
            f"{value!r} is no day; expected YYYY-MM-DD, 2026-01-31 for example", ctx, parameter
        ) from None


def _filters(function: Callable[..., Any]) -> Callable[..., Any]:
    for option in (
        click.option("--since", metavar="YYYY-MM-DD", callback=_day, help="Only from this day on."),
        click.option(
            "--verdict",
            default="",
            metavar="|".join(_COLOURS),
            callback=_verdict,
            help="Only with this verdict.",
        ),
        _BENCH,
        _PROCEDURE,
        click.option("--all", "within", is_flag=True, help="Also the runs of campaigns and commissionings."),
        click.option("--limit", type=click.IntRange(1), default=30, show_default=True, help="Most rows."),
    ):
        function = option(function)
    return function


@click.group(cls=SuggestingGroup)
def command() -> None:
    """Earlier runs in a folder: list, open, search, trends.

    Example: hil results list --procedure bring_up
    """


@command.command("list")
@_IN
@_filters
@JSON
def list_results(where: Path, as_json: bool, **asked: Any) -> int:
    """List runs with time, bench and verdict, the latest first.

    Example: hil results list --verdict FAIL --since 2026-01-31
    """
    return _tell(where, as_json, asked, ())


@command.command()
@click.argument("words", nargs=-1, required=True)
@_IN
@_filters
@JSON
def search(words: tuple[str, ...], where: Path, as_json: bool, **asked: Any) -> int:
    """List only results with all WORDS: names, errors, notes, faults, seed and parameters as KEY=VALUE.

    Example: hil results search tracker "not held"
    """
    return _tell(where, as_json, asked, tuple(word.casefold() for word in words))


def _tell(where: Path, as_json: bool, asked: Mapping[str, Any], words: Sequence[str]) -> int:
    from hil.report.history.index import find_results
    from hil.report.history.query import chosen

    limit = asked["limit"]
    found = chosen(
        find_results(where),
        procedure=asked["procedure"],
        bench=asked["bench"],
        verdict=asked["verdict"],
        since=asked["since"],
        words=words,
        within=asked["within"],
    )
    shown = found[:limit]
    if as_json:
        reported = {"folder": str(where), "found": len(found), "results": [_as_json(kept) for kept in shown]}
        click.echo(json.dumps(reported, allow_nan=False))
        return EXIT_PASS
    for kept in shown:
        _print(kept)
    if not found:
        click.echo(f"nothing in {where} fits")
    elif len(found) > limit:
        click.echo(f"{len(found) - limit} more; --limit {len(found)} shows all")
    return EXIT_PASS


def _as_json(kept: Kept) -> dict[str, Any]:
    tree = kept.result
    return {
        "name": kept.name,
        "folder": str(kept.folder),
        "kind": kept.kind,
        "procedure": kept.what,
        "when": kept.when.isoformat(timespec="seconds"),
        "bench": kept.bench,
        "where": kept.where,
        "verdict": kept.verdict,
        "why": kept.why,
        "within": kept.within,
        "measurements": {row["name"]: row["value"] for row in tree.get("measurements", ())},
    }


def _print(kept: Kept) -> None:
    from hil.support.file_reading import printable

    word = kept.verdict or kept.kind
    mark = click.style(f"{word:12}", fg=_COLOURS.get(word))
    on = f"{kept.bench} ({kept.where})" if kept.where else kept.bench
    when = f"{kept.when.astimezone():%Y-%m-%d %H:%M}"
    line = printable(f"{when}  {{}}  {kept.what:22} {on:28} {kept.name}")
    click.echo(line.replace("{}", mark, 1).rstrip())
    problem = kept.result.get("error") or next(iter(kept.result.get("teardown_errors", ())), None)
    said = problem["message"] if problem else "; ".join(_key_rows(kept)) or kept.why
    if said:
        click.echo(printable(f"{'':18}{said}"))


def _key_rows(kept: Kept) -> list[str]:
    """Rows of the most important measurements: failed ones, then those nearest to their limits."""
    from hil.report.page_formats import digits_of, number
    from hil.report.run_summary import missing_words

    def nearness(row: Mapping[str, Any]) -> tuple[bool, float]:
        limits = [abs(v) for v in (row["low"], row["high"]) if v]
        return row["outcome"] != "FAIL", (row["margin"] or 0.0) / max([*limits, 1e-12])

    rows = [
        r
        for r in kept.result.get("measurements", ())
        if r["outcome"] == "FAIL" or (r["value"] is not None and r["limited"])
    ]
    reported = []
    for row in sorted(rows, key=nearness)[:_KEY_ROWS]:
        digits = digits_of(row)
        limits = [
            f"{w} {number(row[k], digits)}"
            for w, k in (("at least", "low"), ("at most", "high"))
            if row[k] is not None
        ]
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        bad = " FAIL" if row["outcome"] == "FAIL" else ""
        value = missing_words(row) if row["value"] is None else f"{number(row['value'], digits)}{unit}"
        within = f" ({', '.join(limits)})" if limits else ""
        reported.append(f"{row['name']} {value}{within}{bad}")
    return reported


@command.command("open")
@click.argument("run", type=RUN, default="last")
@_IN
@click.option(
    "--browser/--no-browser", default=None, help="Show the page [default: where there is a screen]."
)
@JSON
def open_result(run: str, where: Path, browser: bool | None, as_json: bool) -> int:
    """Print the page of RUN, and show it. RUN is a name from the list, a part of one, or `last`.

    The page of a run or a live session is written if it is missing.

    Example: hil results open bring_up
    """
    import os
    import sys

    from hil.report.history.index import find_results
    from hil.report.history.opening import page_of
    from hil.report.history.query import named

    kept = named(find_results(where), run)
    with reporting(quiet=as_json) as report:
        page = page_of(kept, report)
    if browser is None:
        screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        browser = bool(screen) and sys.stdout.isatty() and not as_json
    click.echo(json.dumps({**_as_json(kept), "page": str(page)}) if as_json else shown_path(page))
    if browser:
        click.launch(str(page))
    return EXIT_PASS


@command.command()
@_IN
@_PROCEDURE
@_BENCH
@click.option("--out", type=OUT, help="Page to write [default: trends.html in the folder].")
@click.option(
    "--strict", is_flag=True, help="Exit with 1 when a measurement drifts, is outside or is missing."
)
@JSON
def trends(where: Path, procedure: str, bench: str, out: Path | None, strict: bool, as_json: bool) -> int:
    """Each measurement over all runs of a bench: is it steady, does it drift, when will it reach its limit?

    Example: hil results trends --bench lab
    """
    from hil.report.history.index import find_results
    from hil.report.history.page import headline, write_trends_page
    from hil.report.history.query import chosen
    from hil.report.history.series import ALARMS, groups
    from hil.report.result_reader import own_file
    from hil.support.file_reading import printable

    found = groups(chosen(find_results(where), procedure=procedure, bench=bench, within=True))
    page = None
    if found:
        page = write_trends_page(own_file(where, TRENDS) if out is None else out, found)
    if as_json:
        reported = {"page": str(page) if page else None, "groups": [_group_json(g) for g in found]}
        click.echo(json.dumps(reported, allow_nan=False))
    else:
        click.echo(headline(found))
        for group in found:
            urgent = [s for s in group.series if s.state in ALARMS]
            runs = f"{len(group.runs)} run{'s' * (len(group.runs) != 1)}"
            runs += f" and {group.early} that ended early" if group.early else ""
            click.echo(printable(f"{group.title}: {runs}, {len(urgent) or 'none'} to look at"))
            for series in urgent:
                click.echo(printable(f"    {series.name} {series.in_words()}"))
        click.echo(
            f"page: {shown_path(page)}" if page else f"No page was written: {where} holds nothing to follow."
        )
    alarmed = any(s.state in ALARMS for g in found for s in g.series)
    return EXIT_LIMIT_FAILED if strict and alarmed else EXIT_PASS


def _group_json(group: Any) -> dict[str, Any]:
    return {
        "procedure": group.procedure,
        "bench": group.bench,
        "where": group.where,
        "runs": len(group.runs),
        "ended_early": group.early,
        "settings": json.loads(group.settings),
        "measurements": [
            {
                "name": s.name,
                "unit": s.unit,
                "limits": [s.low, s.high],
                "values": [p.value for p in s.points],
                "calibrations": [p.calibration for p in s.points],
                "runs": [p.run for p in s.points],
                "words": s.in_words(),
                **vars(s.chart),
                "state": s.state,
                "missing": s.missing,
            }
            for s in group.series
        ],
    }
