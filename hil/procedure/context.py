"""What a procedure gets: parameters, a bench, steps that are limited in time and can be resumed, results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hil.procedure.bench_source import BenchSource
from hil.procedure.benches import RunBenches
from hil.procedure.interrupts import Interrupts
from hil.procedure.journal import Entry, Journal
from hil.procedure.measurements import Measurement
from hil.procedure.operator import Operator
from hil.procedure.outputs import Keep, as_json
from hil.recording.mcap_writer import OnFailure
from hil.vocabulary.clock import NS_PER_S, Clock
from hil.vocabulary.errors import HilError, UsageError
from hil.vocabulary.progress import WHOLE, Report

STEP_LIMIT_S = 1800.0
_GO_ON = "the steps that follow, and what they measure, are left out; --resume goes on with them"


class Context(RunBenches):
    """One run of a procedure, as seen from inside.

    Args:
        parameters, procedure, clock, started: as in the attributes.
        report: receives progress.
        source, folder, declared, journal, operator, interrupts, past, past_held, on_recording_failure, keep:
            as for `RunBenches`.

    Attributes:
        procedure: its name.
        parameters: the procedure's, typed.
        clock: for how long computing takes; the bench has its own.
        started: date and time at which the run began, ISO 8601.
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
        past_held: Sequence[Entry] = (),
        on_recording_failure: OnFailure = "stop",
        keep: Keep = "all",
    ) -> None:
        super().__init__(
            source,
            folder,
            declared=declared,
            journal=journal,
            operator=operator,
            interrupts=interrupts,
            past=past,
            past_held=past_held,
            on_recording_failure=on_recording_failure,
            keep=keep,
        )
        self.procedure, self.parameters = procedure, parameters
        self.clock, self.started = clock, started
        self._report = report
        self._past = dict(past)
        self._seen: set[str] = set()
        self._teardown: list[tuple[str, Callable[[], None]]] = []
        self._early: list[tuple[str, Callable[[], object]]] = []

    @contextmanager
    def step(self, title: str, timeout_s: float = STEP_LIMIT_S) -> Iterator[None]:
        """Mark a step: journaled, limited in time on the bench clock, and a place to end in order.

        Raises:
            Aborted: at its beginning or end, after SIGINT.
            StepTimeoutError: more than `timeout_s` passed on the bench's clock. A loop that runs is ended, in
                virtual time whatever else waits for the clock, too; else it is raised at the end.
        """
        self._interrupts.finish_here(f"before the step {title!r}", _GO_ON)
        entry: Entry = {"title": title, "depth": len(self._titles), "outcome": "failed"}
        self.findings.steps.append(entry)
        self._journal.add("step", {"title": title})
        self._report(title, 0, 1)
        self._titles.append(title)
        begin_ns, passed_s = self.clock.now_ns(), self.guard.passed_s
        self.guard.push_limit(f"step {title!r}", timeout_s)
        try:
            yield
            self.guard.must_be_in_time()
            entry["outcome"] = "done"
        finally:
            self._titles.pop()
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
            self.left.enter(title)
            finished, before = False, self._world_at()
            try:
                value = as_json(f"the result of checkpoint {title!r}", function())
                self.guard.must_be_in_time()
                after = self._world_at()
                moved = after is not None and after != before
                self._journal.add("value", {"title": title, "value": value, "moved": moved})
                finished = True
            finally:
                self.left.leave(finished=finished)
        return value

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

    def on_early_end(self, action: Callable[[], object], title: str = "evaluating what was finished") -> None:
        """Have something done where the run ends early: measurements of what was finished until then.

        It gets the time of a teardown, before what `on_teardown` has registered, and the bench may be in any
        state. A run that comes to its end does not do it.
        """
        self._early.append((title, action))

    def take_early_end(self) -> list[tuple[str, Callable[[], object]]]:
        """The actions of `on_early_end` in their order; empty afterwards."""
        actions, self._early = self._early, []
        return actions

    def take_teardown(self) -> list[tuple[str, Callable[[], None]]]:
        """The registered actions in the order in which they are to run; empty afterwards."""
        actions, self._teardown = self._teardown[::-1], []
        return actions
