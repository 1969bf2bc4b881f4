"""Concludes a run: its errors with name and step, its verdict, and the facts of `result.json`."""

import errno
from pathlib import Path
from typing import Any

from hil.bench.hold.held_state import untouched
from hil.bench.injection import nothing_hit, was_missed, with_chips
from hil.bench.unreached_faults import not_begun, not_met_in_words
from hil.config.device_place import device_place
from hil.core.call_chain import as_json, chain_of, place_of
from hil.core.errors import EXIT_ABORTED, EXIT_DEVICE, EXIT_USAGE, Aborted, HilError
from hil.faults.fault import Fault
from hil.procedure.context import Context
from hil.procedure.measurements import Verdict, worst
from hil.procedure.parameters import as_dict
from hil.procedure.run_benches import RunBenches
from hil.procedure.run_result import Failure, Result, git_revision, judge

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def failure(problem: BaseException, context: Context, where: str = "") -> Failure:
    """Convert an exception to a `Failure` with its exit code; `where` names the step, by default the last."""
    step, finished = (where, False) if where else _place(context)
    if isinstance(problem, HilError):
        code = EXIT_ABORTED if isinstance(problem, Aborted) else problem.exit_code
        frames = () if code == EXIT_ABORTED else as_json(chain_of(problem))
        return Failure(type(problem).__name__, str(problem), step, code, finished, tuple(frames))
    no_room = isinstance(problem, OSError) and problem.errno in _NO_ROOM
    code = EXIT_ABORTED if no_room or isinstance(problem, KeyboardInterrupt) else EXIT_USAGE
    frames = as_json(chain_of(problem, shipped=True))
    message = f"{problem} ({place_of(problem)})"
    return Failure(type(problem).__name__, message, step, code, finished, tuple(frames))


def _place(context: Context) -> tuple[str, bool]:
    """Return (failed step, False), else (last step, which was finished, True); `start` before the first."""
    steps = context.findings.steps
    failed = [s["title"] for s in steps if s["outcome"] == "failed"]
    if failed:
        return failed[-1], False
    return (steps[-1]["title"], True) if steps else (context.where, False)


def not_held(context: Context, known: Failure | None) -> list[Failure]:
    """Return errors for benches that did not hold the robot, if the run has no other error.

    If there is another error and the run had several benches, notes name the benches without hold instead.
    """
    lost = [(bench.name, bench.held.why) for bench in context.benches.left.not_held]
    if known is None:
        return [Failure("NotHeld", f"{name}: {why}", "closing the bench", EXIT_DEVICE) for name, why in lost]
    if context.benches.left.opened > 1:
        context.findings.notes += [f"NOT HELD: {name}: {why}" for name, why in lost]
    return []


def without_effect(context: Context, known: Failure | None) -> list[Failure]:
    """Return the error for faults in front of real devices that hit no message, if the run has no other."""
    specs = _idle(context.benches)
    if known is not None or not specs:
        return []
    return [Failure("FaultWithoutEffect", nothing_hit(specs), "closing the bench", EXIT_USAGE)]


def _idle(benches: RunBenches) -> list[str]:
    """Return the faults in front of real devices that hit no message, as texts."""
    return [str(row["fault"]) for row in benches.injected if was_missed(row)]


def conclude(context: Context, error: Failure | None, late: list[Failure], facts: dict[str, Any]) -> Result:
    """Return the result; its verdict is ABORTED or ERROR after an error, else that of the worst measurement.

    Args:
        context: context after the end of the body.
        error: error that ended the body early.
        late: errors of the teardown.
        facts: further entries of `result.json`.
    """
    findings = context.findings
    declared = context.results.declared
    told = findings.earlier, findings.measured_in, findings.doubts
    rows = judge(declared, findings.values, *told, error is None)
    verdict = worst(Verdict(r["outcome"]) for r in rows if r["outcome"] != "NOT MEASURED")
    if late:
        verdict = Verdict.ERROR
    if error is not None:
        verdict = Verdict.ABORTED if error.exit_code == EXIT_ABORTED else Verdict.ERROR
    return Result(context.procedure, verdict, context.folder, rows, facts, error, tuple(late))


def facts_of(context: Context, wall_s: float, error: Failure | None) -> dict[str, Any]:
    """Return the entries of `result.json` beside verdict and measurements.

    Args:
        context: context after the end of the body.
        wall_s: duration of body and teardown, s.
        error: error that ended the body early; a note names any other device that failed.
    """
    from hil.support.versions import versions

    proc, benches, past = context.proc, context.benches, context.benches.past
    findings, source = context.findings, context.source
    missed: tuple[Fault, ...] = ()
    planned = source.planned_faults()
    if past is None:  # the world time that an interrupted run reached is not known
        missed = not_begun(planned, benches.world_ns) + (benches.too_early or ())
    times_ns = benches.world_ns, benches.looked_ns, benches.first_cycle_ns
    reported = [not_met_in_words(missed, *times_ns)] if missed else []
    known = "" if error is None else error.message
    header = source.header()
    calibration = header["calibration"] or {}
    if calibration.get("verdict") == "FAIL":
        reported.append(
            f"The calibration {calibration['path']}, version {calibration['version']}, failed its validation "
            "run (verdict FAIL); failed_calibration in the bench file asks for its use."
        )
    if error is not None and (idle := _idle(benches)):
        reported.append(nothing_hit(idle))
    reported += [
        f"A drive or a watch was ended early: {s}" for s in dict.fromkeys(benches.lost) if s != known
    ]
    return {
        "summary": proc.summary,
        "headline": proc.said(findings.values),
        "bench": source.config.name,
        "emulated": list(source.config.emulated()),
        "real": {name: device_place(source.config.devices()[name]) for name in source.real},
        "command": context.options.command,
        "virtual_time": source.virtual,
        "parameters": as_dict(context.parameters),
        **header,
        "versions": versions(),
        "git_revision": git_revision(proc.file.parent if proc.file else Path.cwd()),
        "started": context.started,
        "duration_s": wall_s,
        "bench_duration_s": context.guard.driven_s,
        "resumed": 0 if past is None else past.resumed + 1,
        "steps": findings.steps,
        "tables": findings.tables,
        "figures": findings.figures,
        "attachments": findings.attachments,
        "recordings": (past.recordings if past else []) + findings.recordings,
        "data": findings.data,
        "faults_not_met": list(map(str, missed)),
        "injected": with_chips(benches.injected, planned, benches.world_ns),
        "notes": findings.notes + context.results.set_again() + reported,
        "events": benches.left.events,
        "taken_for_granted": [row.to_json() for row in benches.granted.values()],
        "held": _held(benches),
    }


def _held(benches: RunBenches) -> dict[str, object]:
    if benches.left.held is not None:
        return benches.left.held.to_json()
    return untouched("no device was opened: the robot is as it was before").to_json()
