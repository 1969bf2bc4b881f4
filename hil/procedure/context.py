"""What a procedure gets: parameters, a bench, steps that are limited in time and can be resumed, results."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.procedure import hold_history, path_history
from hil.procedure.bench_source import BenchSource
from hil.procedure.elsewhere import Driven, Errand, Result, Sent, driven
from hil.procedure.guard import LoopGuard
from hil.procedure.interrupts import Interrupts
from hil.procedure.journal import Entry, Journal
from hil.procedure.measurements import Measurement
from hil.procedure.operator import Operator
from hil.procedure.outputs import Keep, Notebook
from hil.procedure.recordings import Recordings
from hil.procedure.workers import Workers
from hil.recording.mcap_writer import OnFailure
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.errors import ConfigError, HilError, RecordingError, UsageError
from hil.vocabulary.progress import WHOLE, Report

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.bench.held import Held

STEP_LIMIT_S = 1800.0
_GO_ON = "the steps that follow, and what they measure, are left out; --resume goes on with them"


class Context(Notebook):
    """One run of a procedure, as seen from inside.

    Args:
        parameters, source, folder, procedure, clock, started: as in the attributes.
        declared: measurements that may be left.
        journal: where finished checkpoints are noted.
        operator: who answers prompts.
        report: receives progress.
        interrupts: signals and time limits.
        past: what an earlier run finished, by title.
        on_recording_failure: what a disk that takes no more means for the run.
        keep: what stays of it.

    Attributes:
        procedure: its name.
        parameters: the procedure's, typed.
        source: which bench, to open it again (`reopen`) or in another process.
        clock: for how long computing takes; the bench has its own.
        started: date and time at which the run began, ISO 8601.
        held: how the bench that was closed last left the robot; None before that. Of benches that were driven
            at once it is that of the last one, or of the first that was not held.
    """

    def __init__(
        self,
        parameters: Any,
        source: BenchSource,
        folder: Path,
        *,
        procedure: str = "",
        declared: Sequence[Measurement],
        journal: Journal,
        clock: Clock,
        started: str,
        operator: Operator,
        report: Report,
        interrupts: Interrupts,
        past: Mapping[str, list[Entry]],
        on_recording_failure: OnFailure = "stop",
        keep: Keep = "all",
    ) -> None:
        super().__init__(folder, declared, journal, keep)
        self.procedure = procedure
        self.parameters, self.source = parameters, source
        self.guard = LoopGuard(interrupts)
        self._operator = operator
        self.clock, self.started = clock, started
        self._report, self._interrupts = report, interrupts
        self._past = dict(past)
        self._recordings = Recordings(
            folder, self.findings.recordings, journal, interrupts, on_recording_failure, self._note_lost,
            keep,
        )  # fmt: skip
        self._hold_history = hold_history.HoldHistory()
        self._path_history = path_history.PathHistory()
        self._seen: set[str] = set()
        self._bench: Bench | None = None
        self._left_behind = False
        self.held: Held | None = None
        self._teardown: list[tuple[str, Callable[[], None]]] = []

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
        """
        again, self._left_behind = self._bench is not None, False
        self.close_bench()
        source = self.source.changed(seed=seed, calibration=calibration, overrides=overrides)
        if source.real and (again or prompt):
            self.prompt(prompt or "put the robot back to its start pose, then press Enter")
        bench = source.open()
        try:
            self._recordings.record(bench, label, lossless=source.virtual)
            bench.add_sink(self.guard)
            for history in (self._hold_history, self._path_history) if self.keep == "all" else ():
                bench.add_sink(history)
            with self._interrupts.deferred():
                bench.__enter__()
                self._bench = bench
            if bench.pressed and bench.pressed not in self.findings.notes and not again:
                self.note(bench.pressed)
        except BaseException:
            bench.close()
            self.held = bench.held
            raise
        self._interrupts.stop_here()
        return bench

    def close_bench(self) -> None:
        """Hold the robot and close the bench, if it is open."""
        bench, self._bench = self._bench, None
        if bench is not None:
            try:
                with self._interrupts.deferred():
                    bench.__exit__(None, None, None)
            finally:
                self.held = bench.held
                self._recordings.finish()

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

        waiting = [one.recording for one in sent]
        held: list[Held] = []
        failed = False
        try:
            for found in workers.at_once(driven, sent):
                recording = waiting.pop(0)
                if recording is not None and recording.exists():
                    self._recordings.add(recording)
                failed = found.error is not None
                self._take_over(found, held)
                yield found.result
        finally:
            for left in waiting:
                if left is not None and left.exists():
                    self._recordings.add(left)
            if waiting and not failed:
                on_wall = self.source.config.environment.on_wall
                self.held = abandoned("the process that drove it was ended with the run", on_wall=on_wall)

    def _take_over(self, found: Driven, held: list[Held]) -> None:
        self.guard.driven_ns += nanoseconds(found.driven_s)
        self._hold_history.follow(found.hold)
        self._path_history.follow(found.path)
        if found.pressed and self.held is None:
            self.note(found.pressed)
        if found.held is not None:
            held.append(found.held)
            self.held = next((h for h in held if h.state == "NOT HELD"), found.held)
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
            self.figure(path, "Path", path_history.CAPTION)
        hold = self._hold_history.figure()
        if hold is not None:
            self.figure(hold, "Adhesion", hold_history.CAPTION)

    def unrecorded(self) -> RecordingError | None:
        """What the run has to end with when cycles are missing from its recordings; None if it need not."""
        return self._recordings.objection()

    def _note_lost(self, text: str) -> None:
        """A note that is left even where the journal does not take it."""
        with suppress(HilError):
            self._journal.add("note", {"text": text})
        self.findings.notes.append(text)

    @contextmanager
    def step(self, title: str, timeout_s: float = STEP_LIMIT_S) -> Iterator[None]:
        """Mark a step: journaled, limited in time on the bench clock, and a place to end in order.

        Raises:
            Aborted: at its beginning or end, after SIGINT.
            StepTimeoutError: the loop ran longer than `timeout_s` within it.
        """
        self._interrupts.finish_here(f"before the step {title!r}", _GO_ON)
        entry: Entry = {"title": title, "depth": len(self._titles), "outcome": "failed"}
        self.findings.steps.append(entry)
        self._journal.add("step", {"title": title})
        self._report(title, 0, 1)
        self._titles.append(title)
        begin_ns, driven_s = self.clock.now_ns(), self.guard.driven_s
        self.guard.push_limit(f"step {title!r}", timeout_s)
        try:
            yield
            entry["outcome"] = "done"
        finally:
            self._titles.pop()
            self.guard.pop_limit()
            entry["wall_s"] = (self.clock.now_ns() - begin_ns) / NS_PER_S
            entry["bench_s"] = self.guard.driven_s - driven_s
            with suppress(HilError):
                self._journal.add("end_step", entry)
        self._report(title, 1, 1)
        self._interrupts.finish_here(f"after the step {title!r}, which was finished", _GO_ON)

    def checkpoint(self, title: str, function: Callable[[], Any], timeout_s: float = STEP_LIMIT_S) -> Any:
        """A step whose result is kept: a resumed run takes it from the journal instead of repeating it.

        Args:
            title: unique within the run.
            function: does the work; what it measures, attaches and draws is kept with its result.
            timeout_s: as for `step`.

        Returns:
            The function's result as JSON gives it back (tuples become lists).

        Raises:
            UsageError: a title used twice, or a result that is no JSON value.
        """
        if title in self._seen:
            raise UsageError(f"checkpoint {title!r} exists twice", expected="a title of its own")
        self._seen.add(title)
        if title in self._past:
            return self._resumed(title)
        with self.step(title, timeout_s):
            self._journal.add("checkpoint", {"title": title})
            before = self._world_at()
            value = function()
            try:
                kept = json.loads(json.dumps(value))
            except (TypeError, ValueError) as error:
                raise UsageError(
                    f"checkpoint {title!r} returned what JSON cannot hold ({error})",
                    expected="numbers, texts, lists and dictionaries; put arrays into a file",
                ) from None
            after = self._world_at()
            moved = after is not None and after != before
            self._journal.add("value", {"title": title, "value": kept, "moved": moved})
        return kept

    def _world_at(self) -> tuple[int, int] | None:
        """Which emulated world the run has open, and its time; None for none."""
        bench = self._bench
        return None if bench is None or self.source.real else (id(bench), bench.clock.now_ns())

    def finished(self, title: str) -> bool:
        """Whether a resumed run will take this checkpoint from the journal."""
        return title in self._past

    def _resumed(self, title: str) -> Any:
        *entries, last = self._past[title]
        self._left_behind |= bool(last.get("moved"))
        self.take_again(entries, title)
        self.findings.steps.append(
            {"title": title, "depth": len(self._titles), "outcome": "resumed", "wall_s": 0.0, "bench_s": 0.0}
        )
        self._report(f"{title} (from the journal)", 1, 1)
        return last["value"]

    def prompt(self, question: str) -> str:
        """Ask the operator; raises `Aborted` when nobody can answer."""
        answer = self._operator.ask(question)
        self._journal.add("answer", {"question": question, "answer": answer})
        return answer

    def progress(self, what: str, done: int, total: int, whole: tuple[int, int] | None = None) -> None:
        """Say how far the work is.

        Args:
            what: piece of work, in words.
            done: how much of it is done, of
            total: in units of its own.
            whole: (done, total) of the whole run, where that is known: the time left is then its.
        """
        if whole is not None:
            self._report(WHOLE, *whole)
        self._report(what, done, total)

    def on_teardown(self, action: Callable[[], None], title: str = "teardown") -> None:
        """Have something done at the end whatever happens, last registered first, bench still open."""
        self._teardown.append((title, action))

    def take_teardown(self) -> list[tuple[str, Callable[[], None]]]:
        """The registered actions in the order in which they are to run; empty afterwards."""
        actions, self._teardown = self._teardown[::-1], []
        return actions
