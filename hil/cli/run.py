"""`hil run`: a procedure on a bench, to its verdict, results folder and report."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli import start_question
from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.closed_output import kept_for_json, print_end, print_user_calls
from hil.cli.completion_types import SCRIPT
from hil.cli.options import JSON, OUT, on_recording_failure_option, results_folder
from hil.cli.progress import reporting
from hil.cli.question_answers import answers_option, asked_to_end, operator
from hil.cli.ros2_options import published
from hil.core.clock import local_time
from hil.core.errors import HilError, shown_path
from hil.core.result_names import JOURNAL

if TYPE_CHECKING:
    from hil.procedure.run_result import Result
    from hil.recording.mcap_writer import OnFailure


_HELP_AT = 34
_SCRIPT, _WORDS = "the script of this line", "the words of this line"
_NOT_REPEATED = ("--out", "--answers")


class _WithParameters(click.Command):
    """Command whose help also lists the parameters of the procedure named before `--help`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Like click's; keeps what may be a script for `format_epilog`."""
        ctx.meta[_SCRIPT] = next((word for word in args if not word.startswith("-")), None)
        ctx.meta[_WORDS] = tuple(args)
        return super().parse_args(ctx, args)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Print the parameters with their defaults; if the procedure cannot be read, the reason."""
        script = ctx.meta.get(_SCRIPT)
        if script is None:
            return
        from hil.procedure.parameters import described
        from hil.procedure.procedure_lookup import load_procedure

        try:
            proc = load_procedure(script)
        except HilError as error:
            formatter.write(f"\n{error}\n")
            return
        rows = [
            (d.name, f"{d.help}  [default: {d.default or 'none'}]".strip())
            for d in described(proc.parameters)
        ]
        with formatter.section(f"Parameters of {proc.name}, for --set NAME=VALUE"):
            formatter.write_dl(rows or [("none", "")])


@click.command(cls=_WithParameters)
@click.argument("script", type=SCRIPT)
@bench_options(
    "bench",
    "emulate",
    "settings",
    "seed",
    "start_pose",
    "realtime",
    "faults",
    "inject_real",
    "by_hand",
    "calibration",
    bench={"default": None, "help": "Bench file, or a shipped profile [default: the procedure's, emulated]."},
    faults={
        "help": "DEVICE:KIND[@START_S[+DURATION_S]][,OPTION=NUMBER...] in world time, e.g. imu:stuck@2+3; "
        "repeatable. docs/faults.md lists devices, kinds and options."
    },
)
@bench_options("controller", "ros2", "ros2_domain", "ros2_wait", "ros2_interface")
@click.option("--out", type=OUT, help="Results folder [default: out/NAME/TIME].")
@click.option("--resume", is_flag=True, help="Continue an interrupted run (of --out, else the latest).")
@click.option(
    "--dry-run", "dry", is_flag=True, help="Print steps, check limits and trajectories, move nothing."
)
@click.option("--quick", is_flag=True, help="The procedure's quick form; --set counts above it.")
@answers_option
@on_recording_failure_option("recording or journal")
@JSON
def command(
    script: str,
    request: BenchRequest,
    out: Path | None,
    resume: bool,
    dry: bool,
    quick: bool,
    answers: Path | None,
    on_failure: OnFailure,
    as_json: bool,
) -> int:
    """Run a procedure: a path to a Python file, or the name of a shipped one.

    `hil run SCRIPT --help` also lists the parameters of that procedure.

    Example: hil run bring_up --quick --set watch_s=2
    """
    from hil.core.clock import MonotonicClock
    from hil.procedure.parameters import split_settings
    from hil.procedure.procedure_lookup import load_procedure
    from hil.procedure.runner import RunOptions, run_procedure

    with kept_for_json(as_json):
        proc = load_procedure(script)
    given, overrides = split_settings(request.settings)
    parameters = proc.settings(given, quick=quick)
    source = request.source(overrides, otherwise=proc.bench)
    if dry:
        from hil.procedure.runner import dry_run

        plan = dry_run(proc, source, parameters)
        click.echo(json.dumps(plan) if as_json else _plan_text(plan))
        return 0
    source = source.changed(overrides=start_question.asked_start(source.config))
    interrupts = asked_to_end()
    with published(request, source.config) as publisher, interrupts.installed(), interrupts.deferred():
        folder = results_folder(proc.name, out, JOURNAL if resume else None)
        with kept_for_json(as_json), reporting() as report:
            options = RunOptions(
                folder=folder,
                clock=MonotonicClock(),
                started=local_time(),
                parameters=parameters,
                operator=operator(answers),
                report=report,
                resume=resume,
                on_recording_failure=on_failure,
                interrupts=interrupts,
                command=_repeated(click.get_current_context().meta.get(_WORDS, ())),
            )
            if publisher is not None:
                source = replace(source, publish=publisher.sink)
            result = run_procedure(proc, source, options)
        for problem in filter(None, (result.error, *result.teardown_errors)):
            print_user_calls(problem.frames, problem.place)
        page, code = _report_of(result)
        if as_json:
            tree = result.to_json() | {"folder": str(result.folder), "report": page}
            print_end(json.dumps(tree, allow_nan=False), result.facts["held"])
        else:
            print_end(text_of(result), result.facts["held"])
            click.echo(f"report: {shown_path(Path(page)) if page else 'could not be written'}")
        if untested := _untested(result):
            click.echo(f"hil: warning: {untested}", err=True)
    return code


def _repeated(words: Sequence[str]) -> str:
    """The command line that repeats a run, without where its results go and who answers."""
    kept: list[str] = []
    skips = False
    for word in words:
        if not skips and not word.startswith(tuple(f"{name}=" for name in _NOT_REPEATED)):
            kept += [word] if word not in (*_NOT_REPEATED, "--json", "--resume") else []
        skips = not skips and word in _NOT_REPEATED
    return shlex.join(("hil", "run", *kept))


def _untested(result: Result) -> str:
    """A sentence on the faults that met no control cycle; empty where there are none."""
    missed = result.facts["faults_not_met"]
    return f"No control cycle has met {', '.join(missed)}: the run does not test that." if missed else ""


def _report_of(result: Result) -> tuple[str | None, int]:
    """Path of the report, None if it cannot be written, and the exit code of the run."""
    from hil.core.errors import HilError
    from hil.procedure.run_result import KEEPING
    from hil.report.run_page import write_run_page

    if any(e.step == KEEPING for e in result.teardown_errors):
        return None, result.exit_code
    try:
        return str(write_run_page(result.folder)), result.exit_code
    except HilError as error:
        click.echo(f"hil: {error}", err=True)
        return None, result.exit_code or error.exit_code


def _plan_text(plan: dict[str, Any]) -> str:
    lines = [f"{plan['procedure']}: {plan['summary']}", f"bench {plan['bench']}", "parameters:"]
    for key, value in plan["parameters"].items():
        lines.append(f"  {key} = {value}".ljust(_HELP_AT) + f" {plan['help'].get(key, '')}".rstrip())
    lines.append("steps:")
    for step in plan["steps"]:
        driven = ", ".join(f"{t['name']} {t['duration_s']:.1f} s" for t in step["trajectories"])
        lines.append(f"  {step['title']}" + (f"  [{driven}]" if driven else ""))
    lines.append("measurements:")
    for row in plan["measurements"]:
        limits = [f"{s} {row[k]:g}" for s, k in ((">=", "low"), ("<=", "high")) if row[k] is not None]
        lines.append(f"  {row['name']} ({row['unit']}) {' and '.join(limits) or 'reported only'}")
    lines.append(f"{plan['trajectories_checked']} trajectories checked; nothing was moved")
    return "\n".join(lines)


def text_of(result: Result) -> str:
    """A result as text: what ended the run, then the measurements, and the verdict."""
    from hil.bench.hold.held_state import held_in_words
    from hil.core.event_rows import event_lines
    from hil.report.page_formats import digits_of
    from hil.support.file_reading import printable

    lines = []
    for problem in (result.error, *result.teardown_errors):
        if problem is not None:
            lines.append(f"{problem.kind} {problem.place}: {problem.message}")
    measured = [row for row in result.measurements if row["outcome"] != "NOT MEASURED"]
    doubts: dict[str, int] = {}
    for row in measured:
        digits = digits_of(row)
        value = "-" if row["value"] is None else f"{row['value']:.{digits}g}"
        least = max(digits, 6)
        limits = [f"{s} {row[k]:.{least}g}" for s, k in ((">=", "low"), ("<=", "high")) if row[k] is not None]
        mark = ""
        if doubt := row.get("doubt"):
            mark = f"  [{doubts.setdefault(doubt, len(doubts) + 1)}]"
        text = " and ".join(limits) + mark
        lines.append(f"{row['outcome']:13}{row['name']:44}{value:>12} {row['unit']:8}{text}")
    lines += [f"[{number}] {doubt}" for doubt, number in doubts.items()]
    if missing := len(result.measurements) - len(measured):
        lines.append(f"{'NOT MEASURED':13}{missing} of {len(result.measurements)}: the run ended before them")
    lines += [f"note: {note}" for note in result.facts["notes"]]
    lines += [f"seen: {line}" for line in event_lines(result.facts["events"])]
    lines.append(held_in_words(result.facts["held"]))
    said = result.to_json()["said"]
    if result.error:
        said = f"It ended early, {result.error.place}: {result.error.message}"
    untested = _untested(result)
    lines.append(" ".join(filter(None, (f"{result.verdict.value}: {result.procedure}.", said, untested))))
    lines.append(f"results: {shown_path(result.folder)}")
    return printable("\n".join(lines))
