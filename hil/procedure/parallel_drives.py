"""Benches that a run drives in worker processes: recorded and held as the run's own is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hil.core.call_chain import keep_chain
from hil.core.clock import NS_PER_S
from hil.core.errors import DataError, HilError, RecordingError
from hil.procedure.bench_request import BenchSource
from hil.procedure.fit_history import FitHistory
from hil.procedure.hold_history import HoldHistory
from hil.procedure.path_history import PathHistory
from hil.recording.mcap_writer import McapRecorder, OnFailure

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.bench.hold.result import Held

Result = TypeVar("Result")


@dataclass(frozen=True)
class DriveJob(Generic[Result]):
    """A bench that is to be driven in another process.

    Attributes:
        source: opened for it, and closed afterwards.
        drive: called with the bench there. It and what it returns must be fit to be sent between processes.
        label: names the recording, `recording_LABEL.mcap`; empty where none is wanted.
    """

    source: BenchSource
    drive: Callable[[Bench], Result]
    label: str = ""


@dataclass(frozen=True)
class Sent(Generic[Result]):
    """An errand with what the run has decided for it.

    Attributes:
        errand: what to drive.
        recording: file to write; None for none.
        on_failure: what a disk that takes no more means.
    """

    errand: DriveJob[Result]
    recording: Path | None
    on_failure: OnFailure


@dataclass(frozen=True)
class Driven:
    """What came of an errand.

    Attributes:
        result: what `drive` returned; None after an error.
        error: what ended the drive early.
        driven_s: how long it took on the bench's clock, s.
        pressed: as of the bench.
        held: how the bench left the robot.
        tethered: the robot was on a tether.
        world_ns, looked_ns, failed: as `world_ns`, `looked_ns` and `lost` of the bench.
        hold, path, fit: what the figures and the last table of every report are made from.
        lost: why there is no recording, or only a part of it; empty if it is whole or none was wanted.
        objection: what the run has to end with for it.
    """

    result: Any
    error: HilError | None
    driven_s: float
    pressed: str
    held: Held
    tethered: bool
    world_ns: int
    looked_ns: int
    failed: tuple[str, ...]
    hold: HoldHistory
    path: PathHistory
    fit: FitHistory
    lost: str
    objection: RecordingError | None


def driven(sent: Sent[Any]) -> Driven:
    """Drive a bench in this process; an error of the bench comes back as part of the answer.

    Args:
        sent: what to drive, and where it is recorded.

    Raises:
        Exception: whatever is no error of the bench, a mistake in `drive` for one.
    """
    bench = sent.errand.source.open()
    bench.warns_not_held = False
    hold, path, fit = HoldHistory(), PathHistory(), FitHistory()
    tethered = bench.config.safety.tethered
    result, error, driven_s = None, None, 0.0
    try:
        recorder, lost = _recorder(sent, bench)
    except DataError as refused:
        bench.close()
        return Driven(None, refused, 0.0, "", bench.held, tethered, 0, 0, (), hold, path, fit, "", None)
    for sink in (hold, path, fit) if recorder is None else (recorder, hold, path, fit):
        bench.add_sink(sink)
    try:
        with bench:
            begin_ns = bench.clock.now_ns()
            try:
                result = sent.errand.drive(bench)
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
        bench.world_ns,
        bench.looked_ns,
        tuple(bench.lost),
        hold,
        path,
        fit,
        lost,
        objection,
    )


def _recorder(sent: Sent[Any], bench: Bench) -> tuple[McapRecorder | None, str]:
    """The recorder; or None and why a run that may go on without has none."""
    if sent.recording is None:
        return None, ""
    try:
        return McapRecorder(sent.recording, bench.header(), lossless=True, on_failure=sent.on_failure), ""
    except DataError as refused:
        if sent.on_failure == "stop":
            raise
        return None, str(refused)
