"""The benches of a run: opens them in turn or in other processes, records them and their final hold.

`Recordings` selects the files, lists them in the results, and reports incomplete ones.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hil.config.robot_record.overlay import known_parts
from hil.core.cross_check import CrossCheck
from hil.core.errors import ConfigError, DataError, RecordingError
from hil.core.registry import kinds
from hil.faults.fault import Fault
from hil.procedure import fit_history
from hil.procedure.bench_source import BenchSource
from hil.procedure.final_hold import HoldRecord
from hil.procedure.histories import Histories
from hil.procedure.interrupts import Interrupts
from hil.procedure.operator import go_ahead
from hil.procedure.parallel_benches import DriveJob, Driven, Result, Sent, driven
from hil.procedure.run_journal import PastRun
from hil.procedure.run_options import RunOptions
from hil.procedure.run_outputs import RunOutputs, slug
from hil.procedure.run_sinks import RunRecorder, StepTimer
from hil.procedure.worker_processes import Workers
from hil.recording.mcap_writer import OnFailure
from hil.report import device_history, holding_force_history, path_history

if TYPE_CHECKING:
    from hil.bench import Bench


class Recordings:
    """All recordings of one run.

    Args:
        results: outputs that receive names of recordings, and notes on incomplete ones.
        interrupts: signals, deferred while a note is written and a file is closed.
        on_failure: reaction to a full disk, see the attribute.

    Attributes:
        on_failure: reaction to a full disk: `stop`, or `go-on`.
    """

    def __init__(self, results: RunOutputs, interrupts: Interrupts, on_failure: OnFailure) -> None:
        self.on_failure: OnFailure = on_failure
        self._results, self._interrupts = results, interrupts
        self._recorders: list[RunRecorder] = []
        self._newest: RunRecorder | None = None
        self._objections: list[RecordingError] = []

    def path(self, label: str, taken: Sequence[Path | None] = ()) -> Path | None:
        """Return a new path for a recording, not in `taken`; None if the run keeps no recordings."""
        if self._results.keep == "results":
            return None
        stem = f"recording_{slug(label)}" if label else "recording"
        path, number = self._results.folder / f"{stem}.mcap", 1
        while path.exists() or path in taken:
            number += 1
            path = self._results.folder / f"{stem}-{number}.mcap"
        return path

    def record(self, bench: Bench, label: str, *, lossless: bool) -> None:
        """Attach a recorder to a bench; a failure is an error unless the run may go on without a recording.

        Raises:
            DataError: the file cannot be created.
        """
        path, self._newest = self.path(label), None
        if path is None:
            return
        try:
            recorder = RunRecorder(
                str(path), bench.header(), self._interrupts, lossless=lossless, on_failure=self.on_failure
            )
        except DataError as error:
            if self.on_failure == "stop":
                raise
            self._results.note_in_any_case(str(error))
            return
        bench.add_sink(recorder)
        self._newest = recorder
        self._recorders.append(recorder)
        self.add(path)

    def add(self, path: Path) -> None:
        """Add a started recording to results and journal."""
        self._results.findings.recordings.append(path.name)
        self._results.journal.add("recording", {"path": path.name})

    def object(self, objection: RecordingError) -> None:
        """Keep the error of a recording that another process wrote."""
        self._objections.append(objection)

    def finish(self) -> None:
        """Note what is missing from the newest recording, after its bench was closed."""
        if self._newest is not None and self._newest.shortfall:
            self._results.note_in_any_case(
                f"{self._newest.path.name} is not complete: {self._newest.shortfall}"
            )

    def objection(self) -> RecordingError | None:
        """Return the error with which the run has to end if cycles are missing; None for none."""
        return next(filter(None, (*self._objections, *(r.objection() for r in self._recorders))), None)


if TYPE_CHECKING:
    from hil.bench import Bench


class RunBenches:
    """The benches that a run has opened.

    Args:
        source, past: attributes of the same names.
        results: outputs of the run: receives recordings, notes and figures.
        options: options of the run.

    Attributes:
        source: source of the bench, to open it again (`reopen`) or in another process.
        past: the interrupted run that this run resumes; None for a new run.
        opened: the bench if it is open.
        left_behind: True if a finished checkpoint left the emulated robot at another place.
        guard: guard that ends a loop that exceeds its time limit or after a signal.
        left: final hold reports of the closed benches.
        world_ns: time of the emulated world when its bench was closed, ns; the latest of several worlds.
        too_early: faults that were over before the first cycle of every bench; None before the first bench.
        looked_ns: the same for the end of the check of the stopped robot.
        first_cycle_ns: the same for the first cycle.
        lost: messages about devices that ended runs of the loop.
        granted: parameters of the bench file, and what measurements said about them, by key.
        injected: faults in front of real devices, with what they have hit (`Injection.report`).
    """

    def __init__(
        self, source: BenchSource, results: RunOutputs, options: RunOptions, past: PastRun | None
    ) -> None:
        self.source, self.past = source, past
        self.guard = StepTimer(options.interrupts)
        self._results, self._operator, self._interrupts = results, options.operator, options.interrupts
        self._recordings = Recordings(results, options.interrupts, options.on_recording_failure)
        self._histories = Histories()
        self.opened: Bench | None = None
        self._bench_name = ""
        self.left_behind = False
        before, finished = (past.held, past.checkpoints) if past else ((), ())
        self.left = HoldRecord(results.journal, self.guard, before, finished)
        self.world_ns = self.looked_ns = self.first_cycle_ns = 0
        self.too_early: tuple[Fault, ...] | None = None
        self.lost: list[str] = []
        self.granted: dict[str, CrossCheck] = {}
        self.injected: list[dict[str, object]] = []

    @property
    def bench(self) -> Bench:
        """Open bench, as of `Context.bench`; raises `ConfigError`."""
        if self.left_behind:
            raise ConfigError(
                "the emulated robot is no longer where the run that was cut off had left it",
                expected="each checkpoint to begin with ctx.reopen(), or on a bench of its own",
                remedy="start the run anew, without --resume",
            )
        return self.opened if self.opened is not None else self.reopen(self.source)

    def reopen(self, source: BenchSource, label: str = "", prompt: str = "") -> Bench:
        """New bench, as of `Context.reopen`; `source` is that of the run with the changes."""
        again, self.left_behind = self.opened is not None, False
        self.close()
        if source.real and (again or prompt):
            question = prompt or "put the robot back to its start pose, then press Enter"
            self._results.note_answer(question, go_ahead(self._operator, question))
        bench = source.open()
        self._bench_name = self.left.begin(label)
        bench.warns_not_held = False
        bench.undivided = self._interrupts.deferred
        try:
            self._recordings.record(bench, label, lossless=source.virtual)
            bench.add_sink(self.guard)
            for history in self._histories.sinks(drawn=self._results.keep == "all"):
                bench.add_sink(history)
            with self._interrupts.deferred():
                bench.__enter__()
                self.opened = bench
                self.guard.watch(bench.clock, virtual=source.virtual)
            if bench.pressed and bench.pressed not in self._results.findings.notes and not again:
                self._results.note(bench.pressed)
        except BaseException:
            self.guard.leave()
            bench.close()
            self._leave(bench)
            raise
        self._interrupts.stop_here()
        return bench

    def close(self) -> None:
        """Hold the robot and close the bench, if it is open."""
        bench, self.opened = self.opened, None
        self.guard.leave()
        if bench is not None:
            try:
                with self._interrupts.deferred():
                    bench.__exit__(None, None, None)
            finally:
                self._leave(bench)
                self._recordings.finish()

    def doubt(self) -> str:
        """Return which sensors have been left out so far, and since when, as a text; empty for none."""
        rows = [*self.left.events, *([] if self.opened is None else self.opened.seen.rows())]
        out = {row["device"]: row["t_s"] for row in reversed(rows) if row["left_out"]}
        return "; ".join(f"{name} was left out from {t_s:.2f} s on" for name, t_s in out.items())

    def _leave(self, bench: Bench) -> None:
        times_ns = bench.world_ns, bench.looked_ns, bench.first_cycle_ns
        self._came(times_ns, bench.faults_too_early())
        self.lost += bench.lost
        for row in bench.parameters.rows():
            if row.state != "unconfirmed" and not row.on:
                self.granted[row.key] = row
            else:
                self.granted.setdefault(row.key, row)
        self.injected += bench.injection.report()
        tethered = bench.config.safety.tethered
        self.left.add(self._bench_name, bench.held, bench.seen.rows(), tethered=tethered)

    def _came(self, times_ns: tuple[int, int, int], too_early: tuple[Fault, ...]) -> None:
        before = too_early if self.too_early is None else self.too_early
        self.too_early = tuple(fault for fault in before if fault in too_early)
        before_ns = self.world_ns, self.looked_ns, self.first_cycle_ns
        self.world_ns, self.looked_ns, self.first_cycle_ns = map(max, before_ns, times_ns)

    def at_once(self, jobs: Sequence[DriveJob[Result]], workers: Workers) -> Generator[Result, None, None]:
        """Drive benches in worker processes, as `Context.at_once` does."""
        sent: list[Sent[Result]] = []
        for job in jobs:
            taken = [s.recording for s in sent]
            path = self._recordings.path(job.label, taken) if job.label else None
            sent.append(Sent(job, path, self._recordings.on_failure))
        from hil.bench.hold.held_state import abandoned

        waiting = [(self.left.begin(one.job.label), one.recording) for one in sent]
        failed = False
        try:
            for found in workers.at_once(driven, sent):
                name, recording = waiting.pop(0)
                if recording is not None and recording.exists():
                    self._recordings.add(recording)
                failed = found.error is not None
                self._take_over(found, name)
                yield found.result
        finally:
            for _, recording in waiting:
                if recording is not None and recording.exists():
                    self._recordings.add(recording)
            if waiting and not failed:
                on_wall = self.source.config.environment.on_wall
                held = abandoned("the process that drove it was ended with the run", on_wall=on_wall)
                self.left.add(waiting[0][0], held, tethered=False)

    def _take_over(self, found: Driven, name: str) -> None:
        self.guard.add(found.driven_s)
        self._came(found.times_ns, found.too_early)
        self.lost += found.failed
        self._histories.follow(found.histories)
        if found.pressed and self.left.held is None:
            self._results.note(found.pressed)
        self.left.add(name, found.held, found.events, tethered=found.tethered)
        if found.lost:
            self._results.note_in_any_case(found.lost)
        if found.objection is not None:
            self._recordings.object(found.objection)
        if found.error is not None:
            raise found.error

    def show_histories(self) -> None:
        """Add the table of sensor fits, and figures of path, hold and own devices.

        The path is left out where a figure of the procedure shows one, by its title.
        """
        fitted = list(self._histories.fit.rows())
        if fitted:
            noise = known_parts(self.source.config).get("noise")
            note = (
                "NIS, the normalised innovation squared, compares a sensor's deviations from the estimate "
                "with the noise that the filter assumes: 1 where both are alike. Mean per component, while "
                "the robot drove with a filter. "
            )
            if noise is None:
                note += "The assumed noise was never measured on this robot: hil run sensor_noise does."
            else:
                note += f"The assumed noise was measured on {noise.measured[:10]}."
            self._results.table(fit_history.TITLE, fit_history.HEAD, fitted, note)
        if self._results.keep == "results":
            return
        titles = [str(entry["title"]).lower() for entry in self._results.findings.figures]
        path = None if any("path" in title for title in titles) else self._histories.path.figure()
        if path is not None:
            self._results.draw(path, "Path", path_history.CAPTION)
        hold = None if "adhesion" in titles else self._histories.hold.figure()
        if hold is not None:
            self._results.draw(hold, "Adhesion", holding_force_history.CAPTION)
        for name, figure in self._histories.devices.figures():
            self._results.draw(figure, kinds()[name].noun.capitalize(), device_history.CAPTION)

    def unrecorded(self) -> RecordingError | None:
        """Return the error with which the run has to end if recordings lack cycles; None for none."""
        return self._recordings.objection()

    def world_at(self) -> tuple[int, int] | None:
        """Return identity and time, ns, of the open emulated world; None without one."""
        bench = self.opened
        return None if bench is None or self.source.real else (id(bench), bench.clock.now_ns())
