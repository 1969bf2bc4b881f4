"""The context of a procedure: parameters, bench, results, and steps with time limits that can be resumed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.core.clock import NS_PER_S
from hil.core.errors import HilError, UsageError
from hil.procedure.declaration import Procedure
from hil.procedure.measurements import Verdict
from hil.procedure.parallel_benches import DriveJob, Result
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
    """One run of a procedure as its function sees it: steps, benches and results.

    Args:
        proc, parameters, options, results, benches: parts of the run.

    Attributes:
        procedure: name of the procedure.
        parameters: typed parameters of the procedure.
        source: source of the bench, to open it again (`reopen`) or in another process.
        folder: results folder of the run.
        clock: clock of the computing time; the bench has its own clock.
        started: date and time at which the run began, ISO 8601.
        guard: guard that ends a loop that exceeds its time limit or after a signal.
        findings: results so far.
        teardown, early_end: titles and actions registered by `on_teardown` and `on_early_end`.
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
        """Seed of the emulated world and of any other random numbers."""
        return self.source.seed

    @property
    def bench(self) -> Bench:
        """The bench, opened on first use and recorded from then on.

        Raises:
            ConfigError: the emulated robot is not where a finished checkpoint left it, after a resume.
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
            prompt: question for the operator of a real bench instead of the default; also asked before the
            first opening.

        Raises:
            Aborted: the operator says no, or there is no answer.
        """
        changed = self.source.changed(seed=seed, calibration=calibration, overrides=overrides)
        return self.benches.reopen(changed, label, prompt)

    def at_once(self, jobs: Sequence[DriveJob[Result]], workers: Workers) -> Generator[Result, None, None]:
        """Drive benches in worker processes. The run's own bench, if open, is not changed.

        Args:
            jobs: drive jobs.
            workers: processes that run them.

        Yields:
            The result of each job, in the order of the jobs.

        Raises:
            HilError: the error that ended one of the jobs early.
        """
        return self.benches.at_once(jobs, workers)

    def prompt(self, question: str) -> str:
        """Ask the operator; return the answer. Raises `Aborted` without an operator."""
        with self.guard.paused():
            answer = self.options.operator.ask(question)
        return self.results.note_answer(question, answer)

    @property
    def where(self) -> str:
        """Title of the current step."""
        return self.results.where

    def measure(self, name: str, value: float | bool, doubt: str | None = None) -> None:
        """Set a declared measurement. If it is set again, the last value counts and the result notes this.

        Args:
            name: name of the measurement.
            value: one number; NaN for a value that could not be measured.
            doubt: mark in the result: why the value is in doubt or missing; empty for none. By default the
                sensors that were left out during the run.

        Raises:
            UsageError: the measurement is not declared, or the value is not a single number.
        """
        self.results.measure(name, value, self.benches.doubt() if doubt is None else doubt)

    def verdict(self) -> Verdict:
        """The worst outcome of what has been measured so far."""
        return self.results.verdict()

    def passing(self) -> bool:
        """Whether every limit that has been measured so far holds."""
        return self.verdict() is not Verdict.FAIL

    def table(
        self, title: str, head: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
    ) -> None:
        """Add a table to the results; cells become text, floats get four significant digits.

        Args:
            title: title, unique in the run.
            head: one label per column.
            rows: cells, one per column.
            note: a sentence below the table.

        Raises:
            UsageError: another table has this title, or a row has a wrong number of cells.
        """
        self.results.table(title, head, rows, note)

    def figure(self, figure: Figure | Callable[[], Figure], title: str, caption: str = "") -> None:
        """Save a matplotlib figure as SVG, unless the run keeps only `results`.

        Args:
            figure: figure, or a function that draws it; the function is called only if figures are kept.
            title: title, unique in the run.
            caption: description of what it shows.

        Raises:
            UsageError: not a figure, or another figure has this title.
        """
        self.results.figure(figure, title, caption)

    def attach(self, name: str, path: Path) -> Path:
        """Keep a file with the results.

        Args:
            name: description for the reader.
            path: the file. It is copied unless it is already in the folder; if the name is taken by a file of
                other content, the copy is named `NAME-2.SUFFIX`.

        Returns:
            Path of the file in the folder.
        """
        return self.results.attach(name, path)

    def leave_data(self, name: str, value: Any) -> None:
        """Add JSON values for other programs to `data` of `result.json`.

        Args:
            name: key of the values.
            value: numbers, texts, lists and dictionaries; numpy numbers and arrays are converted.

        Raises:
            UsageError: the value contains another type.
        """
        self.results.leave_data(name, value)

    def note(self, text: str) -> None:
        """Add a sentence for the reader to the report."""
        self.results.note(text)

    @contextmanager
    def step(self, title: str, timeout_s: float = STEP_LIMIT_S) -> Iterator[None]:
        """Mark a step: noted in the journal, limited in time; a stop request may end the run before or after.

        Raises:
            Aborted: SIGINT has come; raised at the beginning or end of the step.
            StepTimeoutError: more than `timeout_s` passed on the bench's clock. It ends a running loop (in
                virtual time also any other wait on the clock); otherwise it is raised at the end of the step.
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
            title: title, unique within the run.
            function: function that does the work; its measurements, files and figures are kept with its
                result.
            timeout_s: longest time of the step, as for `step`.

        Returns:
            The function's result as JSON gives it back (tuples become lists).

        Raises:
            UsageError: the title is used twice, or the result is not a JSON value.
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
        """Report progress.

        Args:
            what: name of the piece of work.
            done: amount done, in any unit.
            total: total amount, in the same unit.
            whole: progress (done, total) of the whole run, if known; the time left is then computed from it.
        """
        if whole is not None:
            self._report(WHOLE, *whole)
        self._report(what, done, total)

    def on_teardown(self, action: Callable[[], None], title: str = "teardown") -> None:
        """Register an action for the end of the run, also after an error: last first, bench still open."""
        self.teardown.append((title, action))

    def on_early_end(self, action: Callable[[], object], title: str = "evaluating what was finished") -> None:
        """Register an action for an early end of the run, for example to measure what was finished.

        It runs before the actions of `on_teardown`, with the time limit of a teardown action. The bench may
        be in any state. The action does not run if the procedure reaches its end.
        """
        self.early_end.append((title, action))
