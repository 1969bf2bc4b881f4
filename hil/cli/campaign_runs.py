"""The runs of a campaign on the command line: what they share, one of them in a worker, its row."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.vocabulary.errors import EXIT_USAGE, HilError

if TYPE_CHECKING:
    from hil.procedure.bench_source import BenchSource
    from hil.procedure.campaign import Case, Row
    from hil.procedure.declaration import Procedure

FINISHED = ("PASS", "MARGINAL", "FAIL", "ERROR")


@dataclass(frozen=True)
class Setup:
    """What all cases share; texts as given on the command line."""

    script: str
    bench: str | None
    emulate: str | None
    settings: tuple[str, ...]
    faults: tuple[str, ...]
    calibration: str | None
    answers: str | None

    def source(self, proc: Procedure, case: Case) -> tuple[BenchSource, dict[str, str]]:
        """Bench and parameters of one case."""
        from hil.procedure.bench_source import BenchSource
        from hil.procedure.parameters import split_settings

        varied = [f"{key}={value}" for key, value in case.settings if key != "fault"]
        faults = [value for key, value in case.settings if key == "fault" and value != "none"]
        parameters, overrides = split_settings((*self.settings, *varied))
        source = BenchSource(
            self.bench or proc.bench, emulate=self.emulate, seed=case.seed, faults=(*self.faults, *faults),
            overrides=overrides, calibration=Path(self.calibration) if self.calibration else None,
        )  # fmt: skip
        return source, parameters


@dataclass(frozen=True)
class Job:
    """One case with everything that a worker needs to run it."""

    setup: Setup
    case: Case
    folder: str


def run_case(job: Job) -> Row:
    """One case to its results folder (in a worker)."""
    from hil.procedure.journal import NAME
    from hil.procedure.operator import Answers, Terminal
    from hil.procedure.runner import RunOptions, run_procedure
    from hil.procedure.scripts import load_procedure
    from hil.report.run_page import write_run_page
    from hil.vocabulary.clock import MonotonicClock

    folder = Path(job.folder)
    try:
        proc = load_procedure(job.setup.script)
        source, parameters = job.setup.source(proc, job.case)
        operator = Terminal() if job.setup.answers is None else Answers(Path(job.setup.answers))
        options = RunOptions(
            folder=folder, clock=MonotonicClock(), parameters=parameters, operator=operator,
            started=datetime.now().astimezone().isoformat(timespec="seconds"),
            resume=(folder / NAME).exists(),
        )  # fmt: skip
        result = run_procedure(proc, source, options)
        write_run_page(folder)
    except HilError as error:
        return _failed(job, "ERROR", str(error), error.exit_code)
    return _row(job, result.to_json())


def finished(job: Job) -> Row | None:
    """The row of a case that has run to its verdict before; None for one that has not."""
    from hil.report.result_file import read_result

    try:
        tree = read_result(Path(job.folder))
    except HilError:
        return None
    return _row(job, tree) if tree["verdict"] in FINISHED else None


def _row(job: Job, tree: dict[str, Any]) -> Row:
    from hil.procedure.campaign import Row

    kept = ("unit", "value", "outcome", "low", "high")
    error = tree.get("error") or next(iter(tree.get("teardown_errors", [])), None)
    return Row(
        job.case, job.folder, tree["verdict"], tree["exit_code"], tree.get("duration_s") or 0.0,
        {row["name"]: {k: row[k] for k in kept} for row in tree["measurements"]},
        "" if error is None else f"{error['type']} in {error['step']!r}: {error['message']}",
    )  # fmt: skip


def _failed(job: Job, verdict: str, reason: str, code: int) -> Row:
    from hil.procedure.campaign import Row

    return Row(job.case, job.folder, verdict, code, 0.0, {}, reason)


def lost(job: Job, reason: str) -> Row:
    """The row of a case whose worker did not come back."""
    return _failed(job, "LOST", reason, EXIT_USAGE)
