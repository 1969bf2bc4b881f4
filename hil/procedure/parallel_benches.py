"""Drives benches of a run in worker processes; they are recorded and held like the run's own bench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hil.core.call_chain import keep_chain
from hil.core.clock import NS_PER_S
from hil.core.errors import DataError, HilError, RecordingError
from hil.faults.fault import Fault
from hil.procedure.bench_source import BenchSource
from hil.procedure.histories import Histories
from hil.recording.mcap_writer import McapRecorder, OnFailure

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.bench.hold.held_state import Held

Result = TypeVar("Result")


@dataclass(frozen=True)
class DriveJob(Generic[Result]):
    """A bench to drive in another process.

    Attributes:
        source: source of the bench, which is opened for this job and closed afterwards.
        drive: called with the open bench. The function and its result must be picklable.
        label: names the recording, `recording_LABEL.mcap`; empty for no recording.
    """

    source: BenchSource
    drive: Callable[[Bench], Result]
    label: str = ""


@dataclass(frozen=True)
class Sent(Generic[Result]):
    """A drive job with settings of the run.

    Attributes:
        job: the drive job.
        recording: file to write; None for none.
        on_failure: reaction to a full disk: `stop`, or `go-on`.
    """

    job: DriveJob[Result]
    recording: Path | None
    on_failure: OnFailure


@dataclass(frozen=True)
class Driven:
    """Outcome of a drive job.

    Attributes:
        result: result of `drive`; None after an error.
        error: error that ended the drive early.
        driven_s: duration on the bench's clock, s.
        pressed: sentence on what presses the robot on, `pressed` of the bench.
        held: final report of the bench on the hold of the robot.
        tethered: True if the robot was on a tether.
        too_early: faults that ended before the first cycle, `faults_too_early()` of the bench.
        times_ns: `world_ns`, `looked_ns` and `first_cycle_ns` of the bench.
        failed: messages about failed devices, `lost` of the bench.
        histories: values for what every report shows by itself.
        events: events that the bench has seen, as rows of `hil.core.event_rows`.
        lost: reason why the recording is missing or incomplete; empty if it is complete or was not wanted.
        objection: recording error with which the run has to end; None for none.
    """

    result: Any
    error: HilError | None
    driven_s: float
    pressed: str
    held: Held
    tethered: bool
    too_early: tuple[Fault, ...]
    times_ns: tuple[int, int, int]
    failed: tuple[str, ...]
    histories: Histories
    events: list[dict[str, Any]]
    lost: str
    objection: RecordingError | None


def driven(sent: Sent[Any]) -> Driven:
    """Drive a bench in this process; an error of the bench is returned in the outcome.

    Args:
        sent: drive job and file of the recording.

    Raises:
        Exception: any error that is not a `HilError`, for example a mistake in `drive`.
    """
    bench = sent.job.source.open()
    bench.warns_not_held = False
    histories = Histories()
    tethered = bench.config.safety.tethered
    result, error, driven_s = None, None, 0.0
    try:
        recorder, lost = _recorder(sent, bench)
    except DataError as refused:
        bench.close()
        unseen = (), (0, 0, 0), ()
        return Driven(None, refused, 0.0, "", bench.held, tethered, *unseen, histories, [], "", None)
    for sink in (*(() if recorder is None else (recorder,)), *histories.sinks()):
        bench.add_sink(sink)
    try:
        with bench:
            begin_ns = bench.clock.now_ns()
            try:
                result = sent.job.drive(bench)
            finally:
                driven_s = (bench.clock.now_ns() - begin_ns) / NS_PER_S
    except HilError as caught:
        keep_chain(caught)
        error = caught
    except Exception as mistake:
        keep_chain(mistake)
        raise
    objection = None
    if recorder is not None:
        objection = recorder.objection()
        if recorder.shortfall:
            lost = f"{recorder.path.name} is not complete: {recorder.shortfall}"
    return Driven(
        result,
        error,
        driven_s,
        bench.pressed,
        bench.held,
        tethered,
        bench.faults_too_early(),
        (bench.world_ns, bench.looked_ns, bench.first_cycle_ns),
        tuple(bench.lost),
        histories,
        bench.seen.rows(),
        lost,
        objection,
    )


def _recorder(sent: Sent[Any], bench: Bench) -> tuple[McapRecorder | None, str]:
    """Return the recorder; or None and the reason, if the run may continue without a recording."""
    if sent.recording is None:
        return None, ""
    try:
        return McapRecorder(sent.recording, bench.header(), lossless=True, on_failure=sent.on_failure), ""
    except DataError as refused:
        if sent.on_failure == "stop":
            raise
        return None, str(refused)
