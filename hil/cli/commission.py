"""`hil commission`: from a robot as delivered to a verified run on its wall."""

import json
import math
from pathlib import Path
from typing import Any

import click

from hil.cli import start_question
from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.options import JSON, OUT, results_folder
from hil.cli.progress import reporting
from hil.cli.question_answers import answers_option, asked_to_end, operator
from hil.core.clock import local_time
from hil.core.errors import shown_path
from hil.core.result_names import COMMISSIONING_TABLE

DEFAULT = "emulated_delivered"


@click.command()
@bench_options("bench", bench={"default": DEFAULT, "help": "Bench file of the wall, or a shipped profile."})
@click.option("--quick", is_flag=True, help="The short form of every procedure.")
@bench_options("seed")
@click.option("--out", type=OUT, help="Results folder [default: out/commission/TIME].")
@click.option(
    "--resume", is_flag=True, help="Continue an interrupted or failed one (of --out, else the latest)."
)
@bench_options(
    "emulate",
    "realtime",
    "settings",
    "faults",
    "start_pose",
    settings={"metavar": "bench.KEY=VALUE", "help": "Key of the bench file."},
)
@answers_option
@JSON
def command(
    request: BenchRequest, quick: bool, out: Path | None, resume: bool, answers: Path | None, as_json: bool
) -> int:
    """Run all procedures in order, each with the results of those before it, up to lines on the wall.

    Example: hil commission --quick
    """
    from hil.commission import Commission, commission
    from hil.core.clock import MonotonicClock

    source = request.source(_overrides(request.settings))
    source = source.changed(overrides=start_question.asked_start(source.config))
    interrupts = asked_to_end()
    folder = results_folder("commission", out, COMMISSIONING_TABLE if resume else None)
    with interrupts.installed(), interrupts.deferred(), reporting() as report:
        reported, code = commission(
            Commission(
                source,
                folder,
                MonotonicClock(),
                local_time,
                quick=quick,
                resume=resume,
                operator=operator(answers),
                report=report,
                interrupts=interrupts,
            )
        )
    click.echo(json.dumps(reported, allow_nan=False) if as_json else _text(reported))
    return code


def _overrides(settings: tuple[str, ...]) -> dict[str, object]:
    from hil.core.errors import UsageError
    from hil.procedure.parameters import split_settings

    parameters, overrides = split_settings(settings)
    if parameters:
        raise UsageError(
            f"--set {next(iter(parameters))}: commissioning has no parameters",
            expected="bench.KEY=VALUE, a key of the bench file",
        )
    return overrides


def _text(summary: dict[str, Any]) -> str:
    from hil.bench.hold.held_state import held_in_words

    lines = [
        f"{stage['verdict']:10}{stage['name']:26}{stage.get('why', '')}".rstrip()
        for stage in summary["stages"]
    ]
    if summary["wall"]:
        lines.append(f"{'known':44}{'line':>8}{'end mm':>9}{'RMSE x':>9}{'RMSE y':>9}{'heading deg':>13}")
        for name, cases in summary["wall"].items():
            for case, row in cases.items():
                numbers = "".join(f"{1e3 * row[key]:9.2f}" for key in ("end_m", "rmse_x_m", "rmse_y_m"))
                heading = f"{math.degrees(row['rmse_heading_rad']):13.3f}"
                lines.append(f"{name:44}{case:>8}{numbers}{heading}")
    if summary["stopped"] is not None:
        stopped = summary["stopped"]
        lines.append(f"stopped at {stopped['procedure']} ({stopped['verdict']}): {stopped['why']}")
        if stopped["held"] is not None:
            lines.append(held_in_words(stopped["held"]))
        if stopped["held"] is not None and stopped["report"] is None:
            lines.append("the report of this procedure could not be written")
        lines.append(f"what to do: {stopped['do']}")
    if summary["stopped"] is None and not summary["wall"]:
        lines.append("no line was driven on a wall: what the record brings is not verified")
    if open_keys := [row["key"] for row in summary["parameters"] if row["state"] == "unconfirmed"]:
        lines.append(f"taken for granted of the bench file, confirmed by nothing: {', '.join(open_keys)}")
    page = (
        f"the page {shown_path(Path(summary['page']))}"
        if summary["page"]
        else "the page could not be written"
    )
    lines.append(
        f"{summary['verdict']}: the record of the robot is {shown_path(Path(summary['robot']))}, {page}"
    )
    return "\n".join(lines)
