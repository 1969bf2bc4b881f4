"""What a procedure gets: the bench, its parameters, and everything that it may leave in the results."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.clock import NS_PER_S, Clock, nanoseconds
from hil.errors import HilError, UsageError
from hil.procedure.bench_source import BenchSource
from hil.procedure.guard import LoopGuard, RunRecorder
from hil.procedure.interrupts import Interrupts
from hil.procedure.journal import Entry, Journal
from hil.procedure.measurements import Measurement, Verdict, worst
from hil.procedure.operator import Operator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.bench import Bench

Report = Callable[[str, int, int], None]
STEP_LIMIT_S = 1800.0


@dataclass
class Findings:
    """What a run has left so far; the lists hold JSON values."""

    values: dict[str, float] = field(default_factory=dict)
    measured_in: dict[str, str] = field(default_factory=dict)
    steps: list[Entry] = field(default_factory=list)
    tables: list[Entry] = field(default_factory=list)
    figures: list[Entry] = field(default_factory=list)
    attachments: list[Entry] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)


class Context:
    """One run of a procedure, as seen from inside.

    Attributes:
        parameters: the procedure's, typed.
        source: which bench, to open it again (`reopen`) or in another process.
        folder: results folder of the run.
        clock: for how long computing takes; the bench has its own.
        started: date and time at which the run began, ISO 8601.
        findings: what has been left so far.
    """

    def __init__(
        self,
        parameters: Any,
        source: BenchSource,
        folder: Path,
        *,
        declared: Sequence[Measurement],
        journal: Journal,
        clock: Clock,
        started: str,
        operator: Operator,
        report: Report,
        interrupts: Interrupts,
        past: Mapping[str, list[Entry]],
    ) -> None:
        self.parameters, self.source, self.folder = parameters, source, folder
        self.findings = Findings()
        self.guard = LoopGuard(interrupts)
        self._declared = {m.name: m for m in declared}
        self._journal, self._operator = journal, operator
        self.clock, self.started = clock, started
        self._report, self._interrupts = report, interrupts
        self._past = dict(past)
        self._titles: list[str] = []
        self._seen: set[str] = set()
        self._bench: Bench | None = None
        self._teardown: list[tuple[str, Callable[[], None]]] = []

    @property
    def seed(self) -> int:
        """Seed of the emulated world and of whatever else needs one."""
        return self.source.seed

    @property
    def where(self) -> str:
        """Title of the current step."""
        return self._titles[-1] if self._titles else "start"

    @property
    def bench(self) -> Bench:
        """The bench, opened on first use and recorded from then on."""
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
        again = self._bench is not None
        self.close_bench()
        source = self.source.changed(seed=seed, calibration=calibration, overrides=overrides)
        if source.real and (again or prompt):
            self.prompt(prompt or "put the robot back to its start pose, then press Enter")
        bench = source.open()
        bench.add_sink(self._recorder(bench.header(), label, lossless=source.virtual))
        bench.add_sink(self.guard)
        try:
            bench.__enter__()
        except BaseException:
            bench.close()
            raise
        self._bench = bench
        return bench

    def close_bench(self) -> None:
        """Hold the robot and close the bench, if it is open."""
        bench, self._bench = self._bench, None
        if bench is not None:
            bench.__exit__(None, None, None)

    def _recorder(self, header: Mapping[str, object], label: str, *, lossless: bool) -> RunRecorder:
        stem = f"recording_{slug(label)}" if label else "recording"
        path, number = self.folder / f"{stem}.mcap", 1
        while path.exists():
            number += 1
            path = self.folder / f"{stem}-{number}.mcap"
        recorder = RunRecorder(str(path), header, self._interrupts, lossless=lossless)
        self.findings.recordings.append(path.name)
        self._journal.add("recording", {"path": path.name})
        return recorder

    @contextmanager
    def step(self, title: str, timeout_s: float = STEP_LIMIT_S) -> Iterator[None]:
        """Mark a step: journaled, limited in time on the bench clock, and a place to end in order.

        Raises:
            Aborted: at its beginning or end, after SIGINT.
            StepTimeoutError: the loop ran longer than `timeout_s` within it.
        """
        self._interrupts.finish_here()
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
        self._interrupts.finish_here()

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
            return self._replay(title)
        with self.step(title, timeout_s):
            self._journal.add("checkpoint", {"title": title})
            value = function()
            try:
                kept = json.loads(json.dumps(value))
            except (TypeError, ValueError) as error:
                raise UsageError(
                    f"checkpoint {title!r} returned what JSON cannot hold ({error})",
                    expected="numbers, texts, lists and dictionaries; put arrays into a file",
                ) from None
            self._journal.add("value", {"title": title, "value": kept})
        return kept

    def finished(self, title: str) -> bool:
        """Whether a resumed run will take this checkpoint from the journal."""
        return title in self._past

    def _replay(self, title: str) -> Any:
        *entries, last = self._past[title]
        for entry in entries:
            kind, data = entry["kind"], {k: v for k, v in entry.items() if k != "kind"}
            if kind == "measure":
                self._keep_value(data["name"], data["value"], title)
            elif kind in ("table", "figure", "attach"):
                getattr(self.findings, {"attach": "attachments"}.get(kind, kind + "s")).append(data)
            elif kind == "note":
                self.findings.notes.append(data["text"])
        self.findings.steps.append(
            {"title": title, "depth": len(self._titles), "outcome": "resumed", "wall_s": 0.0, "bench_s": 0.0}
        )
        self._report(f"{title} (from the journal)", 1, 1)
        return last["value"]

    def measure(self, name: str, value: float | bool) -> None:
        """Set a declared measurement.

        Raises:
            UsageError: not declared.
        """
        if name not in self._declared:
            raise UsageError(
                f"measurement {name!r} is not declared", expected="one of " + ", ".join(self._declared)
            )
        self._journal.add("measure", {"name": name, "value": float(value)})
        self._keep_value(name, float(value), self.where)

    def _keep_value(self, name: str, value: float, where: str) -> None:
        self.findings.values[name] = value
        self.findings.measured_in[name] = where

    def verdict(self) -> Verdict:
        """The worst outcome of what has been measured so far."""
        values = self.findings.values
        return worst(m.judge(values[n]) for n, m in self._declared.items() if n in values)

    def passing(self) -> bool:
        """Whether every limit that has been measured so far holds."""
        return self.verdict() is not Verdict.FAIL

    def table(
        self, title: str, head: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
    ) -> None:
        """Leave a table; cells become text, a float with four significant digits."""
        cells = [[_cell(v) for v in row] for row in rows]
        entry = {"title": title, "head": [str(h) for h in head], "rows": cells, "note": note}
        self._journal.add("table", entry)
        self.findings.tables.append(entry)

    def figure(self, figure: Figure, title: str, caption: str = "") -> Path:
        """Leave a matplotlib figure as SVG; returns its path."""
        import matplotlib as mpl

        path = self.folder / "figures" / f"{len(self.findings.figures) + 1:02d}_{slug(title)}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": path.stem}):
            figure.savefig(path, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
        entry = {"title": title, "caption": caption, "path": str(path.relative_to(self.folder))}
        self._journal.add("figure", entry)
        self.findings.figures.append(entry)
        return path

    def attach(self, name: str, path: Path) -> Path:
        """Keep a file with the results (copied unless it is already in the folder)."""
        inside = path if path.is_relative_to(self.folder) else self.folder / "attachments" / path.name
        if inside != path:
            inside.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, inside)
        entry = {"name": name, "path": str(inside.relative_to(self.folder))}
        self._journal.add("attach", entry)
        self.findings.attachments.append(entry)
        return inside

    def note(self, text: str) -> None:
        """Leave a sentence for the reader of the report."""
        self._journal.add("note", {"text": text})
        self.findings.notes.append(text)

    def prompt(self, question: str) -> str:
        """Ask the operator; raises `Aborted` when nobody can answer."""
        answer = self._operator.ask(question)
        self._journal.add("answer", {"question": question, "answer": answer})
        return answer

    def count_bench_time(self, driven_s: float) -> None:
        """Add time that a bench of this run has driven in another process, s."""
        self.guard.driven_ns += nanoseconds(driven_s)

    def progress(self, what: str, done: int, total: int) -> None:
        """Say how far the work is."""
        self._report(what, done, total)

    def on_teardown(self, action: Callable[[], None], title: str = "teardown") -> None:
        """Have something done at the end whatever happens, last registered first, bench still open."""
        self._teardown.append((title, action))

    def take_teardown(self) -> list[tuple[str, Callable[[], None]]]:
        """The registered actions in the order in which they are to run; empty afterwards."""
        actions, self._teardown = self._teardown[::-1], []
        return actions


def slug(text: str) -> str:
    """A text as part of a file name."""
    return re.sub(r"[^a-zA-Z0-9]+", "_", text).strip("_").lower()[:60] or "unnamed"


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
