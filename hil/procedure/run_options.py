"""How a procedure is run: its folder, its clock, its operator."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.core.clock import Clock
from hil.procedure.operator import Operator, Terminal
from hil.procedure.run_outputs import Keep
from hil.procedure.stop_requests import Interrupts
from hil.recording.mcap_writer import OnFailure
from hil.support.progress import Report, silent


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
