"""Runs a procedure: checks first, then the function, then the teardown, then the verdict on disk.

Whatever happens in between, the robot ends held, the first error is the one that is reported, and
the results folder is complete.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hil.config.bench import BenchConfig
from hil.procedure.bench_source import BenchSource
from hil.procedure.conclusion import conclude, facts_of, failure, not_held
from hil.procedure.context import Context
from hil.procedure.declaration import Procedure
from hil.procedure.interrupts import Interrupts, time_limit
from hil.procedure.journal import SCHEMA, Entry, Journal, PastRun, differences, drop_torn_line, read_journal
from hil.procedure.learning import keep_parts
from hil.procedure.measurements import Measurement, Verdict
from hil.procedure.operator import Operator, Terminal
from hil.procedure.outputs import Keep
from hil.procedure.parameters import as_dict, make_parameters
from hil.procedure.results import KEEPING, Failure, Result, write_result
from hil.recording.mcap_writer import OnFailure
from hil.vocabulary.clock import NS_PER_S, Clock
from hil.vocabulary.errors import EXIT_ABORTED, ConfigError, DataError, RecordingError, reason_of
from hil.vocabulary.files import make_folder, where_else
from hil.vocabulary.progress import Report, silent
from hil.vocabulary.result_files import JOURNAL, RESULT

_SCRIPT_UNKNOWN = (
    "The run that was cut off was begun by an earlier version, which did not note its script: nobody has "
    "checked that what it had finished was done by the same one."
)
_LEFT_OUT = "Recordings and figures were not kept; the same run without --keep results makes them."


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
        keep: `results` leaves out recordings and figures.
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
    keep: Keep = "all"


def run_procedure(proc: Procedure, source: BenchSource, options: RunOptions) -> Result:
    """Run a procedure to its verdict.

    Args:
        proc: the procedure.
        source: bench that it runs on.
        options: folder, clock, parameters, operator and the like.

    Raises:
        HilError: something was wrong before anything could move (configuration, parameters, journal).
    """
    with options.interrupts.heeded():  # nothing is open, and what a script declares may take for ever
        parameters = make_parameters(proc.parameters, options.parameters, proc.name)
        proc.check_needs(source.config)
        source.check_faults()
        declared = proc.declared(parameters, source.config)
        header = header_of(proc, parameters, declared, source)
    past = _past(options, header, source.config)
    with options.interrupts.installed(), options.interrupts.deferred():
        return _recorded_run(proc, source, options, parameters, declared, header, past)


def _recorded_run(
    proc: Procedure,
    source: BenchSource,
    options: RunOptions,
    parameters: Any,
    declared: tuple[Measurement, ...],
    header: Entry,
    past: PastRun | None,
) -> Result:
    """The run itself, from its first word in the journal to the last in its folder."""
    interrupts = options.interrupts
    journal = Journal(options.folder / JOURNAL, options.on_recording_failure)
    try:
        if past is None:
            journal.add("run", {**header, "started": options.started})
        else:
            journal.add("resume", {"started": options.started})
        context = Context(
            parameters,
            source,
            options.folder,
            procedure=proc.name,
            declared=declared,
            journal=journal,
            clock=options.clock,
            started=options.started,
            operator=options.operator,
            report=options.report,
            interrupts=interrupts,
            past=past.checkpoints if past else {},
            past_held=past.held if past else (),
            on_recording_failure=options.on_recording_failure,
            keep=options.keep,
        )
        if past is not None and "script" not in past.header:
            context.note(_SCRIPT_UNKNOWN)
        if options.keep == "results" and past is None:
            context.note(_LEFT_OUT)
        begin_ns = options.clock.now_ns()
        error, late, statistics = _execute(proc, context, interrupts)
        wall_s = (options.clock.now_ns() - begin_ns) / NS_PER_S
        late += not_held(context, error or next(iter(late), None))
        kept = _learnt(proc, context, declared, error, late)
        facts = facts_of(proc, context, past, wall_s, error) | {"loop": statistics, "record": kept}
        result = _kept(conclude(proc, context, declared, error, late, facts))
        with suppress(RecordingError):
            journal.add("end", {"verdict": result.verdict.value})
    finally:
        journal.close()
    return result


def _learnt(
    proc: Procedure,
    context: Context,
    declared: tuple[Measurement, ...],
    error: Failure | None,
    late: list[Failure],
) -> dict[str, Any] | None:
    """What the run adds to the record of the robot; a record that does not take it is one of `late`."""
    verdict = conclude(proc, context, declared, error, late, {}).verdict
    kept, problem = keep_parts(context, verdict)
    if problem is not None:
        late.append(failure(problem, context, "keeping what was found in the record"))
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


def header_of(
    proc: Procedure, parameters: Any, declared: Sequence[Measurement], source: BenchSource
) -> Entry:
    """What a journal says of its run: all that a run that goes on with it must have in common with it."""
    return {
        "schema": SCHEMA,
        "procedure": proc.name,
        "script": proc.script(),
        "measurements": [m.declared() for m in declared],
        "parameters": as_dict(parameters),
        **source.header(),
    }


def _past(options: RunOptions, header: Entry, config: BenchConfig) -> PastRun | None:
    folder = options.folder
    if not options.resume:
        if (folder / JOURNAL).exists() or (folder / RESULT).exists():
            raise ConfigError(
                f"{folder}: holds the results of another run", remedy="choose another --out, or --resume"
            )
        try:
            make_folder(folder)
        except OSError as error:
            raise ConfigError(
                f"{folder}: cannot be created ({reason_of(error)})", remedy=where_else(error)
            ) from None
        return None
    past = read_journal(folder / JOURNAL)
    different = differences(past.header, header, config)
    if different:
        raise ConfigError(
            f"{folder / JOURNAL}: the interrupted run differs in {', '.join(different)}",
            remedy="resume with the same options and the same script, or start anew with another --out",
        )
    drop_torn_line(folder / JOURNAL)
    return past


def _execute(
    proc: Procedure, context: Context, interrupts: Interrupts
) -> tuple[Failure | None, list[Failure], dict[str, float] | None]:
    """The function and the teardown; returns the first error, the teardown's, and loop statistics."""
    error: Failure | None = None
    try:
        with interrupts.heeded():
            proc.perform(context)
            context.show_histories()
    except BaseException as problem:  # whatever a script raises, the robot is held and the results are kept
        error = failure(problem, context)
    late: list[Failure] = []
    statistics = None
    for title, action in context.take_early_end() if error is not None else ():
        _attempt(title, action, proc.teardown_s, context, late)
    for title, action in context.take_teardown():
        _attempt(title, action, proc.teardown_s, context, late)
    if context.opened is not None:
        statistics = context.opened.statistics.summary()
    _attempt("closing the bench", context.close_bench, proc.teardown_s, context, late)
    lost = context.unrecorded()
    if error is None and lost is not None:
        error = failure(lost, context, "recording")
    return error, late, statistics


def _attempt(
    title: str, action: Callable[[], object], limit_s: float, context: Context, late: list[Failure]
) -> None:
    context.guard.push_limit(title, limit_s)
    try:
        with time_limit(limit_s, title):
            action()
    except BaseException as problem:  # the bench has yet to be closed
        late.append(failure(problem, context, title))
    finally:
        context.guard.pop_limit()
