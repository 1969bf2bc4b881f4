"""What a procedure gets: parameters, a bench, steps that are limited in time and can be resumed, results."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.core.clock import NS_PER_S
from hil.core.errors import HilError, UsageError
from hil.procedure.declaration import Procedure
from hil.procedure.measurements import Verdict
from hil.procedure.parallel_drives import DriveJob, Result
from hil.procedure.run_benches import RunBenches
from hil.procedure.run_options import RunOptions
from hil.procedure.run_outputs import RunOutputs, as_json
from hil.procedure.worker_processes import Workers
from hil.support.progress import WHOLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.bench import Bench

STEP_LIMIT_S = 1800.0
_GO_ON = "the steps that follow, and what they measure, are left out; --resume goes on with them"


class Context:
    """One run of a procedure, as seen from inside: its steps, its benches, and what it leaves.

    Args:
        proc, parameters, options, results, benches: what it is put together from.

    Attributes:
        procedure: its name.
        parameters: the procedure's, typed.
        source: which bench, to open it again (`reopen`) or in another process.
        folder: results folder of the run.
        clock: for how long computing takes; the bench has its own.
        started: date and time at which the run began, ISO 8601.
        guard: ends a loop that runs too long, or when a signal came.
        findings: what has been left so far.
        teardown, early_end: what `on_teardown` and `on_early_end` have registered: titles and actions.
    """

    def __init__(
        self, proc: Procedure, parameters: Any, options: RunOptions, results: RunOutputs, benches: RunBenches
    ) -> None:
        self.proc, self.procedure, self.parameters = proc, proc.name, parameters
        self.options, self.results, self.benches = options, results, benches
        self.clock, self.started, self.folder = options.clock, options.started, options.folder
        self.source, self.guard, self.findings = benches.source, benches.guard, results.findings
        self.teardown: list[tuple[str, Callable[[], None]]] = []
        self.early_end: list[tuple[str, Callable[[], object]]] = []
        self._journal, self._interrupts, self._report = results.journal, options.interrupts, options.report
        self._past = benches.past.checkpoints if benches.past else {}
        self._seen: set[str] = set()

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
        return self.benches.bench

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
            Aborted: the operator says no, or there is no answer.
        """
        changed = self.source.changed(seed=seed, calibration=calibration, overrides=overrides)
        return self.benches.reopen(changed, label, prompt)

    def at_once(self, errands: Sequence[DriveJob[Result]], workers: Workers) -> Generator[Result, None, None]:
        """Drive benches in worker processes. The run's own bench, if it is open, stays as it is.

        Args:
            errands: what to drive.
            workers: the processes that drive it.

        Yields:
            What each drive returned, in the order of the errands.

        Raises:
            HilError: what ended one of the drives early.
        """
        return self.benches.at_once(errands, workers)

    def prompt(self, question: str) -> str:
        """Ask the operator; raises `Aborted` where there is no operator."""
        with self.guard.paused():
            answer = self.options.operator.ask(question)
        return self.results.note_answer(question, answer)

    @property
    def where(self) -> str:
        """Title of the current step."""
        return self.results.where

    def measure(self, name: str, value: float | bool) -> None:
        """Set a declared measurement. Of one that is set again the last value counts, and the result says so.

        Raises:
            UsageError: not declared, or not one number.
        """
        self.results.measure(name, value)

    def verdict(self) -> Verdict:
        """The worst outcome of what has been measured so far."""
        return self.results.verdict()

    def passing(self) -> bool:
        """Whether every limit that has been measured so far holds."""
        return self.verdict() is not Verdict.FAIL

    def table(
        self, title: str, head: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
    ) -> None:
        """Leave a table; cells become text, a float with four significant digits.

        Args:
            title: unique in the run.
            head: one label per column.
            rows: cells, as many as labels.
            note: a sentence below it.

        Raises:
            UsageError: a title that another table has, or a row that is longer or shorter than the head.
        """
        self.results.table(title, head, rows, note)

    def figure(self, figure: Figure | Callable[[], Figure], title: str, caption: str = "") -> None:
        """Leave a matplotlib figure as SVG, unless the run keeps its results alone.

        Args:
            figure: to save, or what draws it, which is called only where figures are kept.
            title: unique in the run.
            caption: what to see in it.

        Raises:
            UsageError: what is no figure, or a title that another one has.
        """
        self.results.figure(figure, title, caption)

    def attach(self, name: str, path: Path) -> Path:
        """Keep a file with the results.

        Args:
            name: what it is, for the reader.
            path: of the file. It is copied unless it is already in the folder; the copy of one whose name is
                taken by another content becomes `NAME-2.SUFFIX`.

        Returns:
            Where it lies in the folder.
        """
        return self.results.attach(name, path)

    def leave_data(self, name: str, value: Any) -> None:
        """Leave JSON values for other programs, as `data` of `result.json`.

        Args:
            name: their key.
            value: numbers, texts, lists and dictionaries; numbers and arrays of numpy become such.

        Raises:
            UsageError: anything else in it.
        """
        self.results.leave_data(name, value)

    def note(self, text: str) -> None:
        """Leave a sentence for the reader of the report."""
        self.results.note(text)

    @contextmanager
    def step(self, title: str, timeout_s: float = STEP_LIMIT_S) -> Iterator[None]:
        """Mark a step: journaled, limited in time on the bench clock, and a place to end in order.

        Raises:
            Aborted: at its beginning or end, after SIGINT.
            StepTimeoutError: more than `timeout_s` passed on the bench's clock. A loop that runs is ended, in
                virtual time whatever else waits for the clock, too; else it is raised at the end.
        """
        self._interrupts.finish_here(f"before the step {title!r}", _GO_ON)
        entry = self.results.add_step(title, "failed")
        self._journal.add("step", {"title": title})
        self._report(title, 0, 1)
        self.results.titles.append(title)
        begin_ns, passed_s = self.clock.now_ns(), self.guard.passed_s
        self.guard.push_limit(f"step {title!r}", timeout_s)
        try:
            yield
            self.guard.must_be_in_time()
            entry["outcome"] = "done"
        finally:
            self.results.titles.pop()
            self.guard.pop_limit()
            entry["wall_s"] = (self.clock.now_ns() - begin_ns) / NS_PER_S
            entry["bench_s"] = self.guard.passed_s - passed_s
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
            self.benches.left.enter(title)
            finished, before = False, self.benches.world_at()
            try:
                value = as_json(f"the result of checkpoint {title!r}", function())
                self.guard.must_be_in_time()
                after = self.benches.world_at()
                moved = after is not None and after != before
                self._journal.add("value", {"title": title, "value": value, "moved": moved})
                finished = True
            finally:
                self.benches.left.leave(finished=finished)
        return value

    def finished(self, title: str) -> bool:
        """Whether a resumed run will take this checkpoint from the journal."""
        return title in self._past

    def _resumed(self, title: str) -> Any:
        *entries, last = self._past[title]
        self.benches.left_behind |= bool(last.get("moved"))
        self.results.take_again(entries, title)
        self.results.add_step(title, "resumed", wall_s=0.0, bench_s=0.0)
        self._report(f"{title} (from the journal)", 1, 1)
        return last["value"]

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
        self.teardown.append((title, action))

    def on_early_end(self, action: Callable[[], object], title: str = "evaluating what was finished") -> None:
        """Have something done where the run ends early: measurements of what was finished until then.

        It gets the time of a teardown, before what `on_teardown` has registered, and the bench may be in any
        state. A run that comes to its end does not do it.
        """
        self.early_end.append((title, action))
