"""The benches of a run: opened in turn or in other processes, recorded, and how they left the robot."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hil.procedure import hold_history, path_history
from hil.procedure.bench_source import BenchSource
from hil.procedure.elsewhere import Driven, Errand, Result, Sent, driven
from hil.procedure.guard import LoopGuard
from hil.procedure.interrupts import Interrupts
from hil.procedure.journal import Entry, Journal
from hil.procedure.left_benches import LeftBenches
from hil.procedure.measurements import Measurement
from hil.procedure.operator import Operator, go_ahead
from hil.procedure.outputs import Keep, Notebook
from hil.procedure.recordings import Recordings
from hil.procedure.workers import Workers
from hil.recording.mcap_writer import OnFailure
from hil.vocabulary.errors import ConfigError, HilError, RecordingError

if TYPE_CHECKING:
    from hil.bench import Bench


class RunBenches(Notebook):
    """One run, and the benches that it has opened.

    Args:
        source, folder: as in the attributes.
        declared: measurements that may be left.
        journal: where everything that is left is noted.
        operator: puts a real robot back, and answers prompts.
        interrupts: signals and time limits.
        past: what an earlier run finished, by title.
        past_held: how its benches left the robot.
        on_recording_failure: what a disk that takes no more means for the run.
        keep: what stays of it.

    Attributes:
        source: which bench, to open it again (`reopen`) or in another process.
        guard: ends a loop that runs too long, or when a signal came.
        left: how the benches that were closed left the robot.
        world_ns: how far the emulated world has come when its bench was closed; of several, the one that has
            come farthest.
        looked_ns: the same when the look at the stopped robot was over.
        lost: devices that ended runs of the loop, in words.
    """

    def __init__(
        self,
        source: BenchSource,
        folder: Path,
        *,
        declared: Sequence[Measurement],
        journal: Journal,
        operator: Operator,
        interrupts: Interrupts,
        past: Mapping[str, list[Entry]],
        past_held: Sequence[Entry],
        on_recording_failure: OnFailure,
        keep: Keep,
    ) -> None:
        super().__init__(folder, declared, journal, keep)
        self.source = source
        self.guard = LoopGuard(interrupts)
        self._operator, self._interrupts = operator, interrupts
        self._recordings = Recordings(
            folder, self.findings.recordings, journal, interrupts, on_recording_failure, self._note_lost, keep
        )
        self._hold_history = hold_history.HoldHistory()
        self._path_history = path_history.PathHistory()
        self._bench: Bench | None = None
        self._bench_name = ""
        self._left_behind = False
        self.left = LeftBenches(journal, self.guard, past_held, past)
        self.world_ns = self.looked_ns = 0
        self.lost: list[str] = []

    @property
    def seed(self) -> int:
        """Seed of the emulated world and of whatever else needs one."""
        return self.source.seed

    @property
    def bench(self) -> Bench:
        """The bench, opened on first use and recorded from then on.

        Raises:
            ConfigError: the emulated robot is not where a checkpoint that is not repeated has left it.
        """
        if self._left_behind:
            raise ConfigError(
                "the emulated robot is no longer where the run that was cut off had left it",
                expected="each checkpoint to begin with ctx.reopen(), or on a bench of its own",
                remedy="start the run anew, without --resume",
            )
        return self._bench if self._bench is not None else self.reopen()

    @property
    def opened(self) -> Bench | None:
        """The bench if it is open."""
        return self._bench

    def reopen(
        self,
        label: str = "",
        *,
        seed: int | None = None,
        calibration: Path | None = None,
        overrides: Mapping[str, object] | None = None,
        prompt: str = "",
    ) -> Bench:
        """Close the bench and open it afresh: a new world on an emulated bench.

        On a bench with real devices the operator is asked to put the robot back to its start pose.

        Args:
            label: names the recording, `recording_LABEL.mcap`.
            seed: another seed of the world.
            calibration: another calibration file.
            overrides: further configuration overrides.
            prompt: what to ask of the operator of a real bench instead, also before the first opening.

        Raises:
            Aborted: the operator says no, or nobody answers.
        """
        again, self._left_behind = self._bench is not None, False
        self.close_bench()
        source = self.source.changed(seed=seed, calibration=calibration, overrides=overrides)
        if source.real and (again or prompt):
            question = prompt or "put the robot back to its start pose, then press Enter"
            self._note_answer(question, go_ahead(self._operator, question))
        bench = source.open()
        self._bench_name = self.left.begin(label)
        bench.tells_held = False
        try:
            self._recordings.record(bench, label, lossless=source.virtual)
            bench.add_sink(self.guard)
            for history in (self._hold_history, self._path_history) if self.keep == "all" else ():
                bench.add_sink(history)
            with self._interrupts.deferred():
                bench.__enter__()
                self._bench = bench
                self.guard.watch(bench.clock, virtual=source.virtual)
            if bench.pressed and bench.pressed not in self.findings.notes and not again:
                self.note(bench.pressed)
        except BaseException:
            self.guard.leave()
            bench.close()
            self._leave(bench)
            raise
        self._interrupts.stop_here()
        return bench

    def close_bench(self) -> None:
        """Hold the robot and close the bench, if it is open."""
        bench, self._bench = self._bench, None
        self.guard.leave()
        if bench is not None:
            try:
                with self._interrupts.deferred():
                    bench.__exit__(None, None, None)
            finally:
                self._leave(bench)
                self._recordings.finish()
                for warning in bench.warnings:
                    self._note_lost(warning)

    def _leave(self, bench: Bench) -> None:
        self._came(bench.world_ns, bench.looked_ns)
        self.lost += bench.lost
        if bench.held.opened:
            self.left.add(self._bench_name, bench.held, tethered=bench.config.safety.tethered)

    def _came(self, world_ns: int, looked_ns: int) -> None:
        self.world_ns, self.looked_ns = max(self.world_ns, world_ns), max(self.looked_ns, looked_ns)

    def at_once(self, errands: Sequence[Errand[Result]], workers: Workers) -> Generator[Result, None, None]:
        """Drive benches in worker processes. The run's own bench, if it is open, stays as it is.

        Args:
            errands: what to drive.
            workers: who drives it.

        Yields:
            What each drive returned, in the order of the errands.

        Raises:
            HilError: what ended one of the drives early.
        """
        sent: list[Sent[Result]] = []
        for errand in errands:
            taken = [s.recording for s in sent]
            path = self._recordings.path(errand.label, taken) if errand.label else None
            sent.append(Sent(errand, path, self._recordings.on_failure))
        from hil.bench.held import abandoned

        waiting = [(self.left.begin(one.errand.label), one.recording) for one in sent]
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
        self._came(found.world_ns, found.looked_ns)
        self.lost += found.failed
        self._hold_history.follow(found.hold)
        self._path_history.follow(found.path)
        if found.pressed and self.left.held is None:
            self.note(found.pressed)
        if found.held.opened:
            self.left.add(name, found.held, tethered=found.tethered)
        if found.lost:
            self._note_lost(found.lost)
        if found.objection is not None:
            self._recordings.object(found.objection)
        if found.error is not None:
            raise found.error

    def show_histories(self) -> None:
        """Leave figures of the path, where the procedure left none at all, and of how the robot was held."""
        if self.keep == "results":
            return
        path = None if self.findings.figures else self._path_history.figure()
        if path is not None:
            self._draw(path, "Path", path_history.CAPTION)
        hold = self._hold_history.figure()
        if hold is not None:
            self._draw(hold, "Adhesion", hold_history.CAPTION)

    def unrecorded(self) -> RecordingError | None:
        """What the run has to end with when cycles are missing from its recordings; None if it need not."""
        return self._recordings.objection()

    def _note_lost(self, text: str) -> None:
        """A note that is left even where the journal does not take it."""
        with suppress(HilError):
            self._journal.add("note", {"text": text})
        self.findings.notes.append(text)

    def _world_at(self) -> tuple[int, int] | None:
        """Which emulated world the run has open, and its time; None for none."""
        bench = self._bench
        return None if bench is None or self.source.real else (id(bench), bench.clock.now_ns())

    def prompt(self, question: str) -> str:
        """Ask the operator; raises `Aborted` when nobody can answer."""
        with self.guard.paused():
            answer = self._operator.ask(question)
        return self._note_answer(question, answer)

    def _note_answer(self, question: str, answer: str) -> str:
        self._journal.add("answer", {"question": question, "answer": answer})
        return answer
