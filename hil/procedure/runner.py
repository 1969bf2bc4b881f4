"""Runs a procedure: first checks, then the function, the teardown, and the verdict on disk.

After any error the robot is held, the first error is reported, and the results folder is complete. A dry
run describes what would be done, without moving anything.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hil.bench.loop_settings import geometry_of, motion_limits
from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S
from hil.core.errors import EXIT_ABORTED, ConfigError, DataError, RecordingError, reason_of
from hil.core.result_names import JOURNAL, RESULT
from hil.procedure.bench_source import BenchSource
from hil.procedure.conclusion import conclude, facts_of, failure, not_held, without_effect
from hil.procedure.context import Context
from hil.procedure.declaration import Procedure
from hil.procedure.interrupts import time_limit
from hil.procedure.measurements import Measurement, Verdict
from hil.procedure.needed_devices import with_own_devices
from hil.procedure.parameters import as_dict, described, make_parameters
from hil.procedure.record_parts import keep_parts
from hil.procedure.run_benches import RunBenches
from hil.procedure.run_journal import (
    SCHEMA,
    Entry,
    Journal,
    PastRun,
    differences,
    drop_torn_line,
    read_journal,
)
from hil.procedure.run_options import RunOptions
from hil.procedure.run_outputs import RunOutputs
from hil.procedure.run_result import KEEPING, Failure, Result, write_result
from hil.robot.motion_limits import check
from hil.support.atomic_files import make_folder, where_else
from hil.support.folder_lock import locked

__all__ = ["RunOptions", "dry_run", "header_of", "run_procedure"]

_LEFT_OUT = "Recordings and figures were not kept; the same run without --keep results makes them."


def run_procedure(proc: Procedure, source: BenchSource, options: RunOptions) -> Result:
    """Run a procedure to its verdict.

    Args:
        proc: the procedure.
        source: bench on which to run.
        options: folder, clock, parameters, operator and the like.

    Raises:
        HilError: a problem found before anything could move (configuration, parameters, journal, another run
            at work in the folder).
    """
    with options.interrupts.interruptible():  # nothing is open, and functions of the script may hang
        given = with_own_devices(proc.parameters, options.parameters, source.config)
        parameters = make_parameters(proc.parameters, given, proc.name)
        proc.check_needs(source.config)
        source.check_faults(proc.trajectories(parameters, source.config))
        declared = proc.declared(parameters, source.config)
        header = header_of(proc, parameters, declared, source)
    if not options.resume:
        _make_folder(options.folder)
    with locked(options.folder, "a run"):
        past = _past(options, header, source.config)
        with (
            options.interrupts.installed(),
            options.interrupts.deferred(),
            closing(Journal(options.folder / JOURNAL, options.on_recording_failure)) as journal,
        ):
            journal.add(*_first_word(header, options, past))
            results = RunOutputs(options.folder, declared, journal, options.keep)
            benches = RunBenches(source, results, options, past)
            return _recorded_run(Context(proc, parameters, options, results, benches))


def _make_folder(folder: Path) -> None:
    try:
        make_folder(folder)
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be created ({reason_of(error)})", remedy=where_else(error)
        ) from None


def _first_word(header: Entry, options: RunOptions, past: PastRun | None) -> tuple[str, Entry]:
    """Return kind and data of the first journal entry of a run."""
    begun = {"started": options.started}
    return ("run", {**header, **begun}) if past is None else ("resume", begun)


def _recorded_run(context: Context) -> Result:
    """Run function and teardown, write the result, and end the journal."""
    past, clock = context.benches.past, context.clock
    if context.results.keep == "results" and past is None:
        context.note(_LEFT_OUT)
    begin_ns = clock.now_ns()
    error, late, statistics = _execute(context)
    wall_s = (clock.now_ns() - begin_ns) / NS_PER_S
    late += not_held(context, error or next(iter(late), None))
    late += without_effect(context, error or next(iter(late), None))
    kept = _learnt(context, error, late)
    facts = facts_of(context, wall_s, error) | {"loop": statistics, "record": kept}
    result = _kept(conclude(context, error, late, facts))
    with suppress(RecordingError):
        context.results.journal.add("end", {"verdict": result.verdict.value})
    return result


def _learnt(context: Context, error: Failure | None, late: list[Failure]) -> dict[str, Any] | None:
    """Add the parts of the run to the robot's record; an error of the record is appended to `late`."""
    verdict = conclude(context, error, late, {}).verdict
    kept, problem = keep_parts(context, verdict)
    if problem is not None:
        late.append(failure(problem, context, "keeping what was found in the record"))
    return kept


def _kept(result: Result) -> Result:
    """Write the result; return it, with the error added if it cannot be written."""
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
    """Return the journal header: all settings that a resumed run must share."""
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


def _execute(context: Context) -> tuple[Failure | None, list[Failure], dict[str, float] | None]:
    """Run function and teardown; return the first error, the errors of the teardown, and loop statistics."""
    benches, limit_s = context.benches, context.proc.teardown_s
    error: Failure | None = None
    try:
        with context.options.interrupts.interruptible():
            context.proc.perform(context)
            benches.show_histories()
    except BaseException as problem:  # the robot is held and results are kept after any error of a script
        error = failure(problem, context)
    late: list[Failure] = []
    statistics = None
    if error is not None:
        with context.results.replacing():
            for title, action in tuple(context.early_end):
                _attempt(title, action, limit_s, context, late)
    for title, action in context.teardown[::-1]:
        _attempt(title, action, limit_s, context, late)
    if benches.opened is not None:
        statistics = benches.opened.statistics.summary()
    _attempt("closing the bench", benches.close, limit_s, context, late)
    if error is not None:  # what was driven until then is shown, once the robot is held
        with context.results.replacing():
            _attempt("drawing the figures", partial(_show, context), limit_s, context, late)
    lost = benches.unrecorded()
    if error is None and lost is not None:
        error = failure(lost, context, "recording")
    return error, late, statistics


def _show(context: Context) -> None:
    """Draw what was driven until an early end, unless the user does not want to wait for it."""
    with context.options.interrupts.left_out_on_request("drawing figures of what was driven"):
        context.benches.show_histories()


def _attempt(
    title: str, action: Callable[[], object], limit_s: float, context: Context, late: list[Failure]
) -> None:
    context.guard.push_limit(title, limit_s)
    try:
        with time_limit(limit_s, title):
            action()
    except BaseException as problem:  # the bench still has to be closed
        late.append(failure(problem, context, title))
    finally:
        context.guard.pop_limit()


def dry_run(proc: Procedure, source: BenchSource, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Check everything that can be checked before a run.

    Args:
        proc: the procedure.
        source: bench on which it would run.
        settings: parameters by name.

    Returns:
        JSON values: procedure, parameters and their descriptions (`help`), measurements with limits,
        steps with their trajectories.

    Raises:
        ConfigError, TrajectoryError: the first problem found.
    """
    config = source.config
    given = with_own_devices(proc.parameters, settings, config)
    parameters = make_parameters(proc.parameters, given, proc.name)
    proc.check_needs(config)
    source.check_faults(proc.trajectories(parameters, config))
    source.describe_calibration()
    steps = []
    for step in proc.steps(parameters, config):
        for trajectory in step.trajectories:
            check(trajectory, geometry_of(config).projection(), motion_limits(config))
        driven = [{"name": t.name, "duration_s": t.duration_s} for t in step.trajectories]
        steps.append({"title": step.title, "trajectories": driven})
    return {
        "procedure": proc.name,
        "summary": proc.summary,
        "bench": config.name,
        "parameters": as_dict(parameters),
        "help": {d.name: d.help for d in described(proc.parameters) if d.help},
        "measurements": [
            {"name": m.name, "unit": m.unit, "low": m.low, "high": m.high, "rationale": m.rationale}
            for m in proc.declared(parameters, config)
        ],
        "steps": steps,
        "trajectories_checked": sum(len(s["trajectories"]) for s in steps),
    }
