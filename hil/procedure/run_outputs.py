"""Outputs of a run: measurements, tables, figures, files and notes, each stored immediately.

Every output is written to the journal first, so that a killed run can be resumed.
"""

from __future__ import annotations

import filecmp
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hil.config.robot_record import NewPart
from hil.core.errors import HilError, UsageError
from hil.procedure.measurements import Measurement, Verdict, worst
from hil.procedure.run_journal import Entry, Journal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Keep = Literal["all", "results"]
"""Files that a run keeps: `all`, or `results` without recordings and figures."""
_LISTED = 6
"""Number of values that a note lists for a measurement that was set repeatedly."""


@dataclass
class Findings:
    """Outputs of a run so far; the lists hold JSON values, `learned` holds parts for the robot's record.

    `earlier` holds the previous values of a measurement that was set again to a different value, `doubts` why
    one rests on a sensor that was left out, or has no value.
    """

    values: dict[str, float] = field(default_factory=dict)
    earlier: dict[str, list[float]] = field(default_factory=dict)
    measured_in: dict[str, str] = field(default_factory=dict)
    doubts: dict[str, str] = field(default_factory=dict)
    steps: list[Entry] = field(default_factory=list)
    tables: list[Entry] = field(default_factory=list)
    figures: list[Entry] = field(default_factory=list)
    attachments: list[Entry] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)
    learned: dict[str, NewPart] = field(default_factory=dict)


class RunOutputs:
    """Collects the outputs of one run.

    Args:
        folder, declared, journal, keep: attributes of the same names.

    Attributes:
        folder: results folder of the run.
        declared: declared measurements; no others can be set.
        journal: journal that receives every output.
        keep: `results` for a run without figures.
        findings: outputs so far.
        titles: titles of the running steps, the innermost last.
    """

    def __init__(
        self, folder: Path, declared: Sequence[Measurement], journal: Journal, keep: Keep = "all"
    ) -> None:
        self.folder, self.declared, self.journal, self.keep = folder, tuple(declared), journal, keep
        self.findings = Findings()
        self.titles: list[str] = []
        self._replaces = False
        self._by_name = {m.name: m for m in declared}
        self._undrawn: list[Entry] = []

    @property
    def where(self) -> str:
        """Title of the current step; `start` outside of all steps."""
        return self.titles[-1] if self.titles else "start"

    def add_step(self, title: str, outcome: str, **passed_s: float) -> Entry:
        """Add a step to the results; return its entry, in which the caller updates the outcome."""
        entry: Entry = {"title": title, "depth": len(self.titles), "outcome": outcome, **passed_s}
        self.findings.steps.append(entry)
        return entry

    def measure(self, name: str, value: float | bool, doubt: str = "") -> None:
        """Store a measurement, as `Context.measure` does; raises `UsageError`."""
        if name not in self._by_name:
            raise UsageError(
                f"measurement {name!r} is not declared", expected="one of " + ", ".join(self._by_name)
            )
        number = _one_number(value)
        if number is None:
            script = sys._getframe(2)
            raise UsageError(
                f"measurement {name!r} was set to {_what(value)} "
                f"({Path(script.f_code.co_filename).name}, line {script.f_lineno})",
                expected="one number",
                remedy="measure one element of it, its mean or its largest",
            )
        self.journal.add("measure", {"name": name, "value": number, "doubt": doubt})
        self._keep_value(name, number, self.where, doubt)

    def _keep_value(self, name: str, value: float, where: str, doubt: str) -> None:
        before = self.findings.values.get(name)
        if before is not None and repr(before) != repr(value):  # NaN is NaN
            self.findings.earlier.setdefault(name, []).append(before)
        self.findings.values[name] = value
        self.findings.measured_in[name], self.findings.doubts[name] = where, doubt

    def verdict(self) -> Verdict:
        """The worst outcome of what has been measured so far."""
        values = self.findings.values
        return worst(m.judge(values[n]) for n, m in self._by_name.items() if n in values)

    def set_again(self) -> list[str]:
        """Return a sentence about each measurement that was set to different values."""
        notes = []
        for name, before in self.findings.earlier.items():
            measurement, every = self._by_name[name], [*before, self.findings.values[name]]
            reported = [
                f"{value:.6g} {measurement.unit}".rstrip()
                + f" ({measurement.judge(value).value})" * measurement.limited
                for value in every
            ]
            if len(reported) > _LISTED:
                reported[_LISTED - 1 : -1] = ["..."]
            notes.append(f"{name} was set {len(every)} times: {', '.join(reported)}. The last one counts.")
        return notes

    @contextmanager
    def replacing(self) -> Iterator[None]:
        """Let a table or figure of this block replace one of its title, and add no note twice.

        At an early end, an evaluation that was interrupted is done again.
        """
        self._replaces = True
        try:
            yield
        finally:
            self._replaces = False

    def table(
        self, title: str, head: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
    ) -> None:
        """Add a table, as `Context.table` does; raises `UsageError`."""
        place = self._place("table", title, self.findings.tables)
        cells = [[_cell(v) for v in row] for row in rows]
        for number, row in enumerate(cells, start=1):
            if len(row) != len(head):
                raise UsageError(
                    f"table {title!r}: row {number} has {len(row)} cells",
                    expected=f"{len(head)}, one for each label of the head",
                )
        entry = {"title": title, "head": [str(h) for h in head], "rows": cells, "note": note}
        self.journal.add("table", entry)
        self.findings.tables[place : place + 1] = [entry]

    def figure(self, figure: Figure | Callable[[], Figure], title: str, caption: str = "") -> None:
        """Save a figure, as `Context.figure` does; raises `UsageError`."""
        if self.keep == "results":
            place = self._place("figure", title, self._undrawn)
            self._undrawn[place : place + 1] = [{"title": title}]
            return
        self.draw(figure, title, caption, self._place("figure", title, self.findings.figures))

    def _place(self, what: str, title: str, entries: Sequence[Entry]) -> int:
        """Index of a new entry: the end, or that of the entry which it replaces."""
        same = [index for index, entry in enumerate(entries) if entry["title"] == title]
        if same and not self._replaces:
            raise UsageError(f"{what} {title!r} exists twice", expected="a title of its own")
        return same[0] if same else len(entries)

    def draw(
        self, figure: Figure | Callable[[], Figure], title: str, caption: str, place: int | None = None
    ) -> None:
        """Save a figure without a check of its title; raises `UsageError` if it is not a figure.

        Args:
            figure: a matplotlib figure, or a function that returns one.
            title: its title.
            caption: text below it.
            place: index among the figures; the end when None.
        """
        from matplotlib.figure import Figure

        from hil.report.page_figures import save_figure

        place = len(self.findings.figures) if place is None else place
        drawn: object = figure() if callable(figure) else figure
        if not isinstance(drawn, Figure):
            raise UsageError(
                f"figure {title!r} is a {type(drawn).__name__}",
                expected="a matplotlib Figure, or a function that returns one",
            )
        path = self.folder / "figures" / f"{place + 1:02d}_{slug(title)}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        save_figure(drawn, path)
        entry = {"title": title, "caption": caption, "path": str(path.relative_to(self.folder))}
        self.journal.add("figure", entry)
        self.findings.figures[place : place + 1] = [entry]

    def attach(self, name: str, path: Path) -> Path:
        """Attach a file, as `Context.attach` does."""
        inside = path if path.is_relative_to(self.folder) else self._place_of(path)
        if inside != path:
            inside.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, inside)
        entry = {"name": name, "path": str(inside.relative_to(self.folder))}
        self.journal.add("attach", entry)
        self.findings.attachments.append(entry)
        return inside

    def _place_of(self, path: Path) -> Path:
        """Return the path for a copy of a file: a new one, or an existing one with the same content."""
        inside, number = self.folder / "attachments" / path.name, 1
        while inside.exists() and not filecmp.cmp(path, inside, shallow=False):
            number += 1
            inside = inside.with_name(f"{path.stem}-{number}{path.suffix}")
        return inside

    def leave_data(self, name: str, value: Any) -> None:
        """Keep data, as `Context.leave_data` does; raises `UsageError`."""
        found = as_json(f"data {name!r}", value, default=_plain)
        self.journal.add("data", {"name": name, "value": found})
        self.findings.data[name] = found

    def note(self, text: str) -> None:
        """Add a sentence for the reader to the report."""
        if self._replaces and text in self.findings.notes:
            return
        self.journal.add("note", {"text": text})
        self.findings.notes.append(text)

    def note_in_any_case(self, text: str) -> None:
        """Add a note, even if the journal cannot be written."""
        with suppress(HilError):
            self.journal.add("note", {"text": text})
        self.findings.notes.append(text)

    def note_answer(self, question: str, answer: str) -> str:
        """Write the operator's answer to the journal; return it."""
        self.journal.add("answer", {"question": question, "answer": answer})
        return answer

    def take_again(self, entries: Sequence[Entry], title: str) -> None:
        """Restore the outputs of a checkpoint from the journal of an earlier run."""
        lists = {
            "table": self.findings.tables,
            "figure": self.findings.figures,
            "attach": self.findings.attachments,
        }
        for entry in entries:
            kind, data = entry["kind"], {k: v for k, v in entry.items() if k != "kind"}
            if kind == "measure":
                self._keep_value(data["name"], data["value"], title, data["doubt"])
            elif kind in lists:
                lists[kind].append(data)
            elif kind == "data":
                self.findings.data[data["name"]] = data["value"]
            elif kind == "note":
                self.findings.notes.append(data["text"])


def slug(text: str) -> str:
    """Convert a text to a part of a file name."""
    return re.sub(r"[^a-zA-Z0-9]+", "_", text).strip("_").lower()[:60] or "unnamed"


def as_json(what: str, value: Any, default: Callable[[Any], Any] | None = None) -> Any:
    """Return a value as read back from JSON: tuples become lists, keys become texts.

    Args:
        what: description of the value for the error message.
        value: numbers, texts, lists and dictionaries.
        default: function that converts a value of another type; raises `TypeError` if it cannot.

    Raises:
        UsageError: JSON cannot represent the value.
    """
    try:
        return json.loads(json.dumps(value, default=default))
    except (TypeError, ValueError, RecursionError) as error:
        raise UsageError(
            f"{what} is what JSON cannot hold ({error})",
            expected="numbers, texts, lists and dictionaries",
            remedy="put the rest into a file",
        ) from None


def _plain(value: Any) -> Any:
    """Convert a numpy number or array to JSON values."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__}")


def _one_number(value: Any) -> float | None:
    """Convert a single number to `float`; return None for an array, a text or any other type."""
    try:
        return None if isinstance(value, str) or np.ndim(value) else float(value)
    except (TypeError, ValueError):
        return None


def _what(value: object) -> str:
    """Describe a wrong value: an array by its shape, another value by its type and text."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return f"a {type(value).__name__}, {value!r:.60}"


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
