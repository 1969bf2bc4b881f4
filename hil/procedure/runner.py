"""Runs a procedure: checks first, then the function, then the teardown, then the verdict on disk.

Whatever happens in between, the robot ends held, the first error is the one that is reported, and
the results folder is complete.
"""

from __future__ import annotations

import errno
import inspect
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hil.bench.holding import untouched
from hil.config.bench import BenchConfig
from hil.config.recorded import changed_since
from hil.procedure.bench_source import BenchSource
from hil.procedure.context import Context
from hil.procedure.declaration import Procedure
from hil.procedure.interrupts import Interrupts, time_limit
from hil.procedure.journal import NAME, SCHEMA, Entry, Journal, PastRun, drop_torn_line, read_journal
from hil.procedure.learning import keep_parts
from hil.procedure.measurements import Measurement, Verdict, worst
from hil.procedure.operator import Operator, Terminal
from hil.procedure.parameters import as_dict, make_parameters
from hil.procedure.results import KEEPING, RESULT, Failure, Result, git_revision, judge, write_result
from hil.recording.mcap_writer import OnFailure
from hil.vocabulary.clock import NS_PER_S, Clock
from hil.vocabulary.errors import (
    EXIT_ABORTED,
    EXIT_DEVICE,
    EXIT_USAGE,
    Aborted,
    ConfigError,
    DataError,
    HilError,
    RecordingError,
)
from hil.vocabulary.progress import Report, silent

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


@dataclass(frozen=True)
class RunOptions:
    """How to run.

    Attributes:
        folder: results folder; new, or with an interrupted run's journal when `resume` is set.
        clock: for durations.
        started: date and time, ISO 8601.
        parameters: texts of `--set` or typed values.
        operator: who answers prompts.
        report: progress (what, done, total).
        resume: continue from the journal in `folder`.
        on_recording_failure: whether the run has to `stop`, or may `go-on`, once what it does can no longer
            be kept in its recordings and its journal.
        interrupts: signals that the caller takes also before and after the run.
    """

    folder: Path
    clock: Clock
    started: str
    parameters: dict[str, Any]
    operator: Operator = field(default_factory=Terminal)
    report: Report = silent
    resume: bool = False
    on_recording_failure: OnFailure = "stop"
    interrupts: Interrupts = field(default_factory=Interrupts)


def run_procedure(proc: Procedure, source: BenchSource, options: RunOptions) -> Result:
    """Run a procedure to its verdict.

    Args:
        proc: the procedure.
        source: bench that it runs on.
        options: folder, clock, parameters, operator and the like.

    Raises:
        HilError: something was wrong before anything could move (configuration, parameters, journal).
    """
    parameters = make_parameters(proc.parameters, options.parameters, proc.name)
    proc.check_needs(source.config)
    source.check_faults()
    declared = proc.declared(parameters, source.config)
    header = _header(proc, parameters, source)
    past = _past(options, header, source.config)
    with options.interrupts.installed(), options.interrupts.deferred():
        return _recorded_run(proc, source, options, parameters, declared, header, past)


def _recorded_run(
    proc: Procedure, source: BenchSource, options: RunOptions, parameters: Any,
    declared: tuple[Measurement, ...], header: Entry, past: PastRun | None,
) -> Result:  # fmt: skip
    """The run itself, from its first word in the journal to the last in its folder."""
    interrupts = options.interrupts
    journal = Journal(options.folder / NAME, options.on_recording_failure)
    try:
        if past is None:
            journal.add("run", {**header, "started": options.started})
        else:
            journal.add("resume", {"started": options.started})
        context = Context(
            parameters, source, options.folder, procedure=proc.name, declared=declared, journal=journal,
            clock=options.clock, started=options.started, operator=options.operator, report=options.report,
            interrupts=interrupts, past=past.checkpoints if past else {},
            on_recording_failure=options.on_recording_failure,
        )  # fmt: skip
        begin_ns = options.clock.now_ns()
        error, late, statistics = _execute(proc, context, interrupts)
        wall_s = (options.clock.now_ns() - begin_ns) / NS_PER_S
        late += _not_held(context, error or next(iter(late), None))
        kept = _learnt(proc, context, declared, error, late)
        facts = _facts(proc, context, options, past, wall_s) | {"loop": statistics, "record": kept}
        result = _kept(conclude(proc, context, declared, error, late, facts))
        with suppress(RecordingError):
            journal.add("end", {"verdict": result.verdict.value})
    finally:
        journal.close()
    return result


def _learnt(
    proc: Procedure, context: Context, declared: tuple[Measurement, ...], error: Failure | None,
    late: list[Failure],
) -> dict[str, Any] | None:  # fmt: skip
    """What the run adds to the record of the robot; a record that does not take it is one of `late`."""
    verdict = conclude(proc, context, declared, error, late, {}).verdict
    kept, problem = keep_parts(context, verdict)
    if problem is not None:
        late.append(_failure(problem, context, "keeping what was found in the record"))
    return kept


def _kept(result: Result) -> Result:
    """The result, written into its folder; where that fails, the result with that error in it."""
    try:
        write_result(result)
    except DataError as problem:
        failure = Failure(type(problem).__name__, str(problem), KEEPING, EXIT_ABORTED)
        verdict = Verdict.ABORTED if result.verdict is Verdict.ABORTED else Verdict.ERROR
        return replace(result, verdict=verdict, teardown_errors=(*result.teardown_errors, failure))
    return result


def _header(proc: Procedure, parameters: Any, source: BenchSource) -> Entry:
    return {
        "schema": SCHEMA,
        "procedure": proc.name,
        "parameters": as_dict(parameters),
        **source.header(),
    }


def _past(options: RunOptions, header: Entry, config: BenchConfig) -> PastRun | None:
    folder = options.folder
    if not options.resume:
        if (folder / NAME).exists() or (folder / RESULT).exists():
            raise ConfigError(
                f"{folder}: holds the results of another run", remedy="choose another --out, or --resume"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be created ({error.strerror})") from None
        return None
    past = read_journal(folder / NAME)
    different = [k for k in header if k != "config" and past.header.get(k) != header[k]]
    different += [f"bench.{key}".rstrip(".") for key in changed_since(past.header.get("config"), config)]
    if different:
        raise ConfigError(
            f"{folder / NAME}: the interrupted run had another {', '.join(different)}",
            remedy="resume with the same options, or start anew",
        )
    drop_torn_line(folder / NAME)
    return past


def _execute(
    proc: Procedure, context: Context, interrupts: Interrupts
) -> tuple[Failure | None, list[Failure], dict[str, float] | None]:
    """The function and the teardown; returns the first error, the teardown's, and loop statistics."""
    error: Failure | None = None
    try:
        with interrupts.heeded():
            proc.body(context)
            context.show_histories()
    except (Exception, KeyboardInterrupt, SystemExit) as problem:
        error = _failure(problem, context)
    late: list[Failure] = []
    statistics = None
    for title, action in context.take_teardown():
        _attempt(title, action, proc.teardown_s, context, late)
    if context.opened is not None:
        statistics = context.opened.statistics.summary()
    _attempt("closing the bench", context.close_bench, proc.teardown_s, context, late)
    lost = context.unrecorded()
    if error is None and lost is not None:
        error = _failure(lost, context, "recording")
    return error, late, statistics


def _attempt(
    title: str, action: Callable[[], None], limit_s: float, context: Context, late: list[Failure]
) -> None:
    context.guard.push_limit(title, limit_s)
    try:
        with time_limit(limit_s, title):
            action()
    except Exception as problem:
        late.append(_failure(problem, context, title))
    finally:
        context.guard.pop_limit()


def _not_held(context: Context, known: Failure | None) -> list[Failure]:
    """A robot that should be held and is not is an error of a run that knows of no other."""
    held = context.held
    if known is not None or held is None or held.state != "NOT HELD" or not held.wanted:
        return []
    return [Failure("NotHeld", held.why, "closing the bench", EXIT_DEVICE)]


def _failure(problem: BaseException, context: Context, where: str = "") -> Failure:
    step = where or _failed_step(context)
    if isinstance(problem, HilError):
        code = EXIT_ABORTED if isinstance(problem, Aborted) else problem.exit_code
        return Failure(type(problem).__name__, str(problem), step, code)
    no_room = isinstance(problem, OSError) and problem.errno in _NO_ROOM
    code = EXIT_ABORTED if no_room or isinstance(problem, KeyboardInterrupt) else EXIT_USAGE
    return Failure(type(problem).__name__, f"{problem} ({_origin(problem)})", step, code)


def _failed_step(context: Context) -> str:
    failed = [s["title"] for s in context.findings.steps if s["outcome"] == "failed"]
    return failed[-1] if failed else context.where


def _origin(problem: BaseException) -> str:
    trace = problem.__traceback__
    frames = inspect.getinnerframes(trace) if trace is not None else []
    return f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}" if frames else "unknown place"


def conclude(
    proc: Procedure,
    context: Context,
    declared: tuple[Measurement, ...],
    error: Failure | None,
    late: list[Failure],
    facts: dict[str, Any],
) -> Result:
    """The verdict: an abort or an error before everything, else the worst measurement.

    Args:
        proc: the procedure.
        context: as the body left it.
        declared: what should have been measured.
        error: what ended the body early.
        late: errors of teardown.
        facts: further entries of `result.json`.
    """
    rows = judge(declared, context.findings.values, context.findings.measured_in, error is None)
    verdict = worst(Verdict(r["outcome"]) for r in rows if r["outcome"] != "NOT MEASURED")
    if late:
        verdict = Verdict.ERROR
    if error is not None:
        verdict = Verdict.ABORTED if error.exit_code == EXIT_ABORTED else Verdict.ERROR
    return Result(proc.name, verdict, context.folder, rows, facts, error, tuple(late))


def _facts(
    proc: Procedure, context: Context, options: RunOptions, past: PastRun | None, wall_s: float
) -> dict[str, Any]:
    from hil.vocabulary.versions import versions

    findings, source = context.findings, context.source
    return {
        "summary": proc.summary,
        "headline": proc.said(findings.values),
        "bench": source.config.name,
        "emulated": list(source.config.emulated()),
        "virtual_time": source.virtual,
        "parameters": as_dict(context.parameters),
        **source.header(),
        "versions": versions(),
        "git_revision": git_revision(Path(inspect.getsourcefile(proc.body) or ".").resolve().parent),
        "started": options.started,
        "duration_s": wall_s,
        "bench_duration_s": context.guard.driven_s,
        "resumed": 0 if past is None else past.resumed + 1,
        "steps": findings.steps,
        "tables": findings.tables,
        "figures": findings.figures,
        "attachments": findings.attachments,
        "recordings": (past.recordings if past else []) + findings.recordings,
        "data": findings.data,
        "notes": findings.notes,
        "held": _held(context),
    }


def _held(context: Context) -> dict[str, object]:
    if context.held is not None:
        return context.held.to_json()
    return untouched("no device was opened: the robot is as it was before").to_json()
