"""`hil campaign`: one procedure over many seeds and settings, in parallel, into one table."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.closed_output import kept_for_json
from hil.cli.completion_types import SCRIPT
from hil.cli.interrupted_series import shown_when_ended
from hil.cli.options import FILE, JSON, OUT
from hil.cli.progress import reporting
from hil.cli.ros2_options import published
from hil.core.errors import (
    EXIT_ABORTED,
    EXIT_LIMIT_FAILED,
    EXIT_PASS,
    Aborted,
    DataError,
    UsageError,
    shown_path,
)
from hil.core.known_names import LAWS
from hil.core.result_names import CAMPAIGN_CSV, CAMPAIGN_PAGE, CAMPAIGN_TABLE, LOST, ROWS, RUNS
from hil.support.atomic_files import check_name, write_text
from hil.support.extras import how_to_install

if TYPE_CHECKING:
    from hil.campaign import Case, Row
    from hil.campaign.run_case import Setup
    from hil.core.interfaces import Sink
    from hil.procedure.declaration import Procedure
    from hil.procedure.run_outputs import Keep

_SHOWN = 5
"""Most broken runs that are named on the terminal."""
_LONGEST = 400
"""Longest error text there, in characters."""
_VERDICTS = {EXIT_PASS: "PASS", EXIT_LIMIT_FAILED: "FAIL"}


@click.command()
@click.argument("script", type=SCRIPT)
@click.option("--seeds", default="0:10", show_default=True, help="Seeds: 0:10 for 0 to 9, or 1,4,7.")
@click.option(
    "--vary",
    "axes",
    multiple=True,
    metavar="KEY=A,B,...",
    help="Setting and its values (repeatable). KEY as in --set, or `fault`.",
)
@bench_options(
    "bench",
    "emulate",
    "settings",
    "faults",
    "calibration",
    "controller",
    "ros2_domain",
    "ros2_interface",
    bench={"default": None, "help": "Bench file, or a shipped profile [default: the procedure's]."},
    settings={"help": "As in hil run, for all cases."},
    faults={"help": "As in hil run, for all cases."},
)
@click.option("--answers", type=FILE, help="File that answers the operator's prompts.")
@click.option(
    "--workers",
    type=click.IntRange(0, 1000),
    help="Processes, by Dask; 0 runs in this one [default: one per core, or 0 without Dask].",
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler to use instead.")
@click.option("--out", type=OUT, help="Results [default: out/campaign_NAME/TIME].")
@click.option(
    "--keep",
    type=click.Choice(["all", "results"]),
    default="all",
    show_default=True,
    help="Of each run; `results` leaves out recordings and figures, for many runs.",
)
@click.option("--resume", is_flag=True, help="Run what is missing in --out; seeds and values may be added.")
@JSON
def command(
    script: str,
    seeds: str,
    axes: tuple[str, ...],
    request: BenchRequest,
    answers: Path | None,
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    keep: Keep,
    resume: bool,
    as_json: bool,
) -> int:
    """Run a procedure over seeds and settings on the emulated bench, in parallel, into one table.

    With a controller on ROS 2 the cases run here, one after the other.

    Example: hil campaign wall_tracking --seeds 0:20 --vary fault=imu:off@5,tracker:off@5
    """
    from hil.campaign import expand, parse_axis, parse_seeds
    from hil.campaign.plan import check, keep_plan, locked_folder
    from hil.campaign.run_case import Setup
    from hil.procedure.procedure_lookup import load_procedure

    if scheduler == "":
        raise UsageError("--scheduler is empty", expected="the address that `dask scheduler` prints")
    with kept_for_json(as_json):
        proc = load_procedure(script)
    cases = expand(parse_seeds(seeds), [parse_axis(text) for text in axes])
    setup = Setup(
        _absolute(script),
        _optional(request.bench or None),
        request.emulate,
        request.settings,
        tuple(map(_absolute, request.faults)),
        _optional(request.calibration),
        _optional(answers),
        keep,
        _optional(request.controller or None),
        request.ros2_domain,
    )
    if request.controller:
        from hil.user_code.roles import CONTROLLER

        if not request.ros2_topic:
            CONTROLLER.check(request.controller)
        if scheduler and request.controller not in LAWS:
            raise UsageError(
                f"--controller {request.controller} is not sent to other computers",
                remedy="leave --scheduler out",
            )
    check(setup, proc, cases)
    processes = _processes(workers, scheduler or "")
    if out is None:
        if resume:
            raise UsageError("--resume needs the folder of the campaign", remedy="name it with --out")
        out = Path("out") / f"campaign_{proc.name}" / datetime.now().strftime("%Y%m%d-%H%M%S")
    out = out.absolute()
    with locked_folder(out, resume=resume):
        keep_plan(out, proc, setup, cases, resume=resume)
        done: dict[Case, Row] = {}

        def finished() -> str:
            return f"{len(done)} of {len(cases)} runs are finished"

        def show() -> str:
            rows = [done[case] for case in cases if case in done]
            return _write(out, proc, setup, cases, rows)["page"] if rows else ""

        try:
            with (
                published(request, setup.source(proc, cases[0])[0].config) as publisher,
                kept_for_json(as_json),
                shown_when_ended(finished, show),
            ):
                publish = None if publisher is None else publisher.sink
                _run(setup, proc, cases, done, out, processes, scheduler or "", publish)
            rows = [done[case] for case in cases]
            tree = _write(out, proc, setup, cases, rows)
        except DataError as error:
            raise Aborted(str(error), remedy="make room, then go on with --resume") from None
    if as_json:
        click.echo(json.dumps(tree, allow_nan=False))
    else:
        click.echo(_text(tree))
        click.echo(f"page: {shown_path(out / CAMPAIGN_PAGE)}")
    return exit_code(rows)


def _processes(asked: int | None, scheduler: str) -> int:
    """Number of worker processes, 0 for this one: as asked, else one per core where Dask is installed.

    Raises:
        UsageError: Dask is asked for, and not installed.
    """
    from hil.campaign import check_dask

    if asked == 0 and not scheduler:
        return 0
    try:
        check_dask()
    except UsageError:
        if asked is not None or scheduler:
            raise
        more = f"several at a time: {how_to_install('campaign')}"
        click.echo(f"Dask is not installed: one run after the other, in this process ({more})", err=True)
        return 0
    return asked if asked is not None else os.cpu_count() or 1


def _absolute(given: str | Path) -> str:
    """Absolute path of a file, because a worker may have another directory; other texts unchanged.

    A procedure chosen from several in a file (`mine.py:name`) keeps its name.
    """
    from hil.procedure.procedure_lookup import file_and_name

    file, name = file_and_name(str(given))
    path = Path(file)
    check_name(path)
    return ":".join(filter(None, (str(path.absolute()), name))) if path.is_file() else str(given)


def _optional(given: str | Path | None) -> str | None:
    return None if given is None else _absolute(given)


def _run(
    setup: Setup,
    proc: Procedure,
    cases: Sequence[Case],
    rows: dict[Case, Row],
    out: Path,
    workers: int,
    scheduler: str,
    publish: Callable[[Mapping[str, Any]], Sink] | None,
) -> None:
    """Run the unfinished cases; `rows` receives every finished row at once.

    With `publish` the cases run in this process, one after the other: one program drives one robot.
    """
    from hil.campaign import spread, write_rows
    from hil.campaign.input_files import files_of
    from hil.campaign.run_case import Delivery, Job, arrived, finished, lost, run_case, run_case_elsewhere

    jobs = [Job(setup, case, str(out / RUNS / case.name)) for case in cases]
    rows.update({job.case: row for job in jobs if (row := finished(job)) is not None})
    missing = [job for job in jobs if job.case not in rows]
    for row in rows.values():
        write_rows(out / ROWS, row, over=False)

    with reporting() as report:

        def done(row: Row) -> None:
            if row.verdict == "ABORTED":
                raise Aborted(f"{row.case.name}: {row.error}", remedy="go on with --resume")
            rows[row.case] = row
            write_rows(out / ROWS, row)
            report("runs", len(rows), len(jobs))

        report("runs", len(rows), len(jobs))
        if missing and scheduler:
            parcel = files_of(setup, proc, cases)
            away = replace(setup, places=parcel.places)
            spread(
                run_case_elsewhere,
                [replace(j, setup=away, input_files=parcel.name) for j in missing],
                lost=lambda job, reason: Delivery(lost(job, reason)),
                done=lambda got: done(arrived(got)),
                scheduler=scheduler,
                parcel=parcel,
            )
        elif missing and publish is not None:
            spread(partial(run_case, publish=publish), missing, lost=lost, done=done, workers=0)
        elif missing:
            spread(run_case, missing, lost=lost, done=done, workers=workers)


def exit_code(rows: Sequence[Row]) -> int:
    """0 all good, 1 a limit failed or no cycle met a fault, else the code of the first broken or lost run."""
    broken = next(
        (row.exit_code for row in rows if row.exit_code not in (EXIT_PASS, EXIT_LIMIT_FAILED)), None
    )
    if broken is not None:
        return broken
    return max(row.exit_code if row.tested else EXIT_LIMIT_FAILED for row in rows)


def _write(
    out: Path, proc: Procedure, setup: Setup, cases: Sequence[Case], rows: Sequence[Row]
) -> dict[str, Any]:
    from hil.campaign import alike, summarise, write_campaign_page, write_csv
    from hil.campaign.plan import SCHEMA
    from hil.campaign.table import count

    early = len(rows) < len(cases)
    code = EXIT_ABORTED if early else exit_code(rows)
    tree: dict[str, Any] = {
        "schema": SCHEMA,
        "procedure": proc.name,
        "summary": proc.summary,
        "bench": setup.source(proc, cases[0])[0].config.name,
        "verdict": "ABORTED" if early else _VERDICTS.get(code, "ERROR"),
        "exit_code": code,
        "cases": len(rows),
        "planned": len(cases),
        "verdicts": count(row.verdict for row in rows),
        "groups": summarise(rows),
        "alike": alike(rows),
        "folder": str(out),
        "page": str(out / CAMPAIGN_PAGE),
        "rows": [{**row.to_json(), "command": setup.command(row.case)} for row in rows],
    }
    write_text(out / CAMPAIGN_TABLE, json.dumps(tree, indent=1, allow_nan=False) + "\n")
    write_csv(out / CAMPAIGN_CSV, rows)
    write_campaign_page(out / CAMPAIGN_PAGE, tree, rows)
    return tree


def _line(error: str) -> str:
    """An error shortened to one line of the terminal; table and page hold the full text."""
    whole = " ".join(error.split())
    return whole if len(whole) <= _LONGEST else f"{whole[:_LONGEST]} ..."


def _text(tree: dict[str, Any]) -> str:
    from hil.campaign.ineffective_settings import in_a_sentence
    from hil.campaign.table import in_words
    from hil.report.page_formats import number

    lines = []
    for group in tree["groups"]:
        lines.append(f"{group['group']}: {_share(group)}")
        for m in group["measurements"]:
            span = f"[{number(m['min'])} to {number(m['max'])}]"
            if m["n"] < m["of"]:
                span += f" in {m['n']} of {m['of']} runs; {in_words(m['missing'])}"
            lines.append(f"  {m['name']:42}{number(m['median']):>11} {m['unit']:6} {span}")
    lines += map(in_a_sentence, tree["alike"])
    broken = [row for row in tree["rows"] if row["verdict"] in ("ERROR", LOST)]
    lines += [f"{row['verdict']} {row['case']}: {_line(row['error'])}" for row in broken[:_SHOWN]]
    if len(broken) > _SHOWN:
        lines.append(f"{len(broken) - _SHOWN} more such runs are in {CAMPAIGN_CSV}")
    counted = ", ".join(f"{n} {verdict}" for verdict, n in tree["verdicts"].items())
    if untested := tree["cases"] - sum(group["tested"] for group in tree["groups"]):
        lost = sum(group["lost"] for group in tree["groups"])
        whys = ["no control cycle met a fault"] * (untested > lost) + ["they left no result"] * bool(lost)
        counted += f"; {untested} of them NOT TESTED: {', or '.join(whys)}"
    return "\n".join([*lines, f"{tree['verdict']}: {tree['procedure']}, {counted}"])


def _share(group: dict[str, Any]) -> str:
    """Share of good runs of a combination in words, among the runs that tested what they should."""
    from hil.campaign.table import not_tested

    said, tested = f"{group['n']} runs", group["tested"]
    if tested:
        low, high = group["pass_share_95"]
        of_tested = "" if tested == group["n"] else f" of {tested} tested"
        share = f"{100 * group['pass_share']:.0f} % good{of_tested}"
        said += f", {share} (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    if tested < group["n"]:
        why = not_tested(group["faults_not_met"], group["lost"])
        said += f", {group['n'] - tested} NOT TESTED: {why}"
    return said
