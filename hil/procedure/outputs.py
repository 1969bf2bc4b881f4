"""What a run leaves for its reader: measurements, tables, figures, files and notes, each kept at once.

Everything goes into the journal before it counts, so that a run that was struck down can be resumed.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hil.config.record import NewPart
from hil.procedure.journal import Entry, Journal
from hil.procedure.measurements import Measurement, Verdict, worst
from hil.vocabulary.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Keep = Literal["all", "results"]
"""What stays of a run: `all`, or `results` without recordings and figures."""


@dataclass
class Findings:
    """What a run has left so far; the lists hold JSON values, `learned` parts of the robot's record."""

    values: dict[str, float] = field(default_factory=dict)
    measured_in: dict[str, str] = field(default_factory=dict)
    steps: list[Entry] = field(default_factory=list)
    tables: list[Entry] = field(default_factory=list)
    figures: list[Entry] = field(default_factory=list)
    attachments: list[Entry] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)
    learned: dict[str, NewPart] = field(default_factory=dict)


class Notebook:
    """The open pages of one run.

    Args:
        folder: results folder of the run.
        declared: measurements that may be left.
        journal: where everything that is left is noted.
        keep: as in the attribute.

    Attributes:
        folder: results folder of the run.
        keep: whether there are figures.
        findings: what has been left so far.
    """

    def __init__(
        self, folder: Path, declared: Sequence[Measurement], journal: Journal, keep: Keep = "all"
    ) -> None:
        self.folder, self.keep = folder, keep
        self.findings = Findings()
        self._declared = {m.name: m for m in declared}
        self._journal = journal
        self._titles: list[str] = []

    @property
    def where(self) -> str:
        """Title of the current step."""
        return self._titles[-1] if self._titles else "start"

    def measure(self, name: str, value: float | bool) -> None:
        """Set a declared measurement.

        Raises:
            UsageError: not declared, or not one number.
        """
        if name not in self._declared:
            raise UsageError(
                f"measurement {name!r} is not declared", expected="one of " + ", ".join(self._declared)
            )
        number = _one_number(value)
        if number is None:
            script = sys._getframe(1)
            raise UsageError(
                f"measurement {name!r} was set to {_what(value)} "
                f"({Path(script.f_code.co_filename).name}, line {script.f_lineno})",
                expected="one number", remedy="measure one element of it, its mean or its largest",
            )  # fmt: skip
        self._journal.add("measure", {"name": name, "value": number})
        self._keep_value(name, number, self.where)

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
        """Leave a table; cells become text, a float with four significant digits.

        Args:
            title: unique in the run.
            head: one label per column.
            rows: cells, as many as labels.
            note: a sentence below it.
        """
        cells = [[_cell(v) for v in row] for row in rows]
        entry = {"title": title, "head": [str(h) for h in head], "rows": cells, "note": note}
        self._journal.add("table", entry)
        self.findings.tables.append(entry)

    def figure(self, figure: Figure | Callable[[], Figure], title: str, caption: str = "") -> None:
        """Leave a matplotlib figure as SVG, unless the run keeps its results alone.

        Args:
            figure: to save, or what draws it, which is called only where figures are kept.
            title: unique in the run.
            caption: what to see in it.
        """
        if self.keep == "results":
            return
        from hil.report.figures import save_figure

        path = self.folder / "figures" / f"{len(self.findings.figures) + 1:02d}_{slug(title)}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure() if callable(figure) else figure, path)
        entry = {"title": title, "caption": caption, "path": str(path.relative_to(self.folder))}
        self._journal.add("figure", entry)
        self.findings.figures.append(entry)

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

    def leave_data(self, name: str, value: Any) -> None:
        """Leave JSON values for other programs, as `data` of `result.json`."""
        self._journal.add("data", {"name": name, "value": value})
        self.findings.data[name] = value

    def note(self, text: str) -> None:
        """Leave a sentence for the reader of the report."""
        self._journal.add("note", {"text": text})
        self.findings.notes.append(text)

    def take_again(self, entries: Sequence[Entry], title: str) -> None:
        """Count what a checkpoint has left in the journal of an earlier run."""
        lists = {
            "table": self.findings.tables,
            "figure": self.findings.figures,
            "attach": self.findings.attachments,
        }
        for entry in entries:
            kind, data = entry["kind"], {k: v for k, v in entry.items() if k != "kind"}
            if kind == "measure":
                self._keep_value(data["name"], data["value"], title)
            elif kind in lists:
                lists[kind].append(data)
            elif kind == "data":
                self.findings.data[data["name"]] = data["value"]
            elif kind == "note":
                self.findings.notes.append(data["text"])


def slug(text: str) -> str:
    """A text as part of a file name."""
    return re.sub(r"[^a-zA-Z0-9]+", "_", text).strip("_").lower()[:60] or "unnamed"


def _one_number(value: Any) -> float | None:
    """A number as `float`; None for an array, a text and whatever else is not one."""
    try:
        return None if isinstance(value, str) or np.ndim(value) else float(value)
    except (TypeError, ValueError):
        return None


def _what(value: object) -> str:
    """A wrong value in words: an array by its shape, else what it is."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return f"a {type(value).__name__}, {value!r:.60}"


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
