"""Options of a run: results folder, clock, operator and others."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.core.clock import Clock
from hil.procedure.interrupts import Interrupts
from hil.procedure.operator import Operator, Terminal
from hil.procedure.run_outputs import Keep
from hil.recording.mcap_writer import OnFailure
from hil.support.progress import Report, silent


@dataclass(frozen=True)
class RunOptions:
    """Options of a run.

    Attributes:
        folder: results folder; new, or with the journal of an interrupted run if `resume` is set.
        clock: clock of durations.
        started: date and time, ISO 8601.
        parameters: texts of `--set` or typed values.
        operator: operator that answers prompts.
        report: function that receives progress (what, done, total).
        resume: True to continue from the journal in `folder`.
        on_recording_failure: reaction to recordings or a journal that can no longer be written: `stop`, or
            `go-on`.
        interrupts: signal handling, which the caller also uses before and after the run.
        keep: `results` leaves out recordings and figures.
        command: command line that repeats the run; empty where no command started it.
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
    command: str = ""
