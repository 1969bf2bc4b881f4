"""The series of each measurement over all runs of a bench, split at calibrations, and its state.

One series holds only comparable runs: one procedure on one bench with the same devices, parameters, faults
and emulated robot (seed). Runs of a campaign are not the history of a bench and are left out. A measurement
without a value in the newest runs is `missing`, not `steady`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby, takewhile
from typing import Any

from hil.core.result_names import PASSED
from hil.report.history.chart import DRIFTING, OUTSIDE, STEADY, TOO_FEW, Chart, individuals_chart
from hil.report.history.index import RUN, Kept
from hil.report.page_formats import number

MISSING = "missing"
"""State of a measurement without a value in the newest runs."""
ALARMS = (MISSING, DRIFTING, OUTSIDE)
"""States that need attention."""
_URGENCY = (*ALARMS, STEADY, TOO_FEW)
_COUNTED = (*PASSED, "FAIL")
"""Verdicts of runs that reached their end; values of aborted runs are left out."""
_EARLY = ("ERROR", "ABORTED")
"""Verdicts of runs that ended early."""


@dataclass(frozen=True)
class Point:
    """One value, with its run, time, calibration and outcome."""

    run: str
    when: datetime
    value: float
    outcome: str
    calibration: str


@dataclass(frozen=True)
class Series:
    """One measurement over the runs of a group.

    Attributes:
        name: name of the measurement.
        unit: unit of its values and limits.
        low, high: limits of the last run; None for none.
        stretches: points between two changes of the calibration, each with its chart, in order; none if no
            run has a value.
        missing: number of the newest runs that have no value, including runs that ended early.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    stretches: tuple[tuple[tuple[Point, ...], Chart], ...]
    missing: int = 0

    @property
    def state(self) -> str:
        """`missing`, else the state of the chart."""
        return MISSING if self.missing else self.chart.state

    @property
    def points(self) -> list[Point]:
        """All points, in order."""
        return [point for points, _ in self.stretches for point in points]

    @property
    def chart(self) -> Chart:
        """Chart of the last stretch: the current state, or the state while there were values."""
        return self.stretches[-1][1] if self.stretches else Chart(TOO_FEW)

    def in_words(self) -> str:
        """Return one sentence about the series."""
        if not self.missing:
            return self._values_in_words()
        if not self.stretches:
            return f"no value in any run ({self.missing})"
        newest = f"the last {self.missing} runs" if self.missing > 1 else "the last run"
        return f"no value in {newest}; before: {self._values_in_words()}"

    def _values_in_words(self) -> str:
        chart, last = self.chart, self.points[-1].value
        unit = "" if self.unit == "1" else f" {self.unit}"
        if chart.state == TOO_FEW:
            runs = len(self.stretches[-1][0])
            return f"{runs} run{'s' * (runs != 1)}: too few to judge"
        if chart.state == DRIFTING:
            return self._drift(chart, unit)
        span = f"{number(chart.low)} to {number(chart.high)}{unit}"
        if chart.state == OUTSIDE:
            return f"{number(last)}{unit} is outside what the runs before it gave ({span})"
        return f"steady, {span}"

    def _drift(self, chart: Chart, unit: str) -> str:
        limit = self.high if chart.slope > 0 else self.low
        ahead = f"drifts by {chart.slope:+.3g}{unit} a run"
        if chart.runs_left is None or limit is None:
            return f"{ahead}, towards no limit"
        if chart.runs_left == 0:
            return f"{ahead} and is at its limit of {number(limit)}{unit}"
        runs = f"{chart.runs_left} run{'s' if chart.runs_left > 1 else ''}"
        return f"{ahead}; at this rate it meets its limit of {number(limit)}{unit} in {runs}"


@dataclass(frozen=True)
class Group:
    """Comparable runs and their measurements, those that need attention first.

    Attributes:
        runs: runs that reached their end, in order.
        early: number of further runs that ended early.
    """

    procedure: str
    bench: str
    where: str
    settings: str
    runs: tuple[Kept, ...]
    series: tuple[Series, ...]
    early: int = 0

    @property
    def title(self) -> str:
        """Title of the group for the reader."""
        how = f" ({self.where})" if self.where else ""
        with_what = f", {self.in_words}" if self.settings != "{}" else ""
        return f"{self.procedure} on {self.bench or 'a bench without a name'}{how}{with_what}"

    @property
    def in_words(self) -> str:
        """Seed, faults and parameters that distinguish the group from other runs of the procedure."""
        reported = []
        for key, value in json.loads(self.settings).items():
            shown = ", ".join(map(str, value)) if isinstance(value, list) else value
            reported.append(f"{key} {shown}")
        return "; ".join(reported)


def groups(found: Sequence[Kept]) -> list[Group]:
    """Group comparable runs; sort groups that need attention first, then by name."""
    runs = [k for k in found if k.kind == RUN and k.verdict in (*_COUNTED, *_EARLY) and not k.of_campaign]
    ordered = sorted(runs, key=lambda k: (_key(k), k.when))
    alike = [(key, tuple(own)) for key, own in groupby(ordered, key=_key)]
    made = [_group(key, own) for key, own in alike if any(k.verdict in _COUNTED for k in own)]
    return sorted(made, key=lambda g: (min((_urgency(s) for s in g.series), default=len(_URGENCY)), g.title))


def _key(kept: Kept) -> tuple[str, str, str, str]:
    tree = kept.result
    settings = {"seed": tree["seed"]} if tree["emulated"] else {}
    settings |= {**tree["parameters"], **({"faults": tree["faults"]} if tree["faults"] else {})}
    return kept.what, kept.bench, kept.where, json.dumps(settings, sort_keys=True, default=str)


def _group(key: tuple[str, str, str, str], every: Sequence[Kept]) -> Group:
    runs = tuple(kept for kept in every if kept.verdict in _COUNTED)
    names = dict.fromkeys(row["name"] for kept in runs for row in kept.result["measurements"])
    series = [_series(name, runs, every) for name in names]
    return Group(*key, runs, tuple(sorted(series, key=_urgency)), len(every) - len(runs))


def _urgency(series: Series) -> int:
    return _URGENCY.index(series.state)


def _row(name: str, kept: Kept) -> Mapping[str, Any] | None:
    return next((row for row in kept.result["measurements"] if row["name"] == name), None)


def _has_value(name: str, kept: Kept) -> bool:
    row = _row(name, kept)
    return row is not None and row["value"] is not None


def _series(name: str, runs: Sequence[Kept], every: Sequence[Kept]) -> Series:
    """Return the series of `runs`, with values missing in `every`. Only values in the last unit are used."""
    rows = [(kept, row) for kept in runs if (row := _row(name, kept)) is not None]
    measured = [(kept, row) for kept, row in rows if row["value"] is not None]
    last = (measured or rows)[-1][1]
    missing = sum(1 for _ in takewhile(lambda kept: not _has_value(name, kept), reversed(every)))
    points = [
        Point(kept.name, kept.when, row["value"], row["outcome"], _calibration(kept.result))
        for kept, row in measured
        if row["unit"] == last["unit"]
    ]
    stretches = [tuple(own) for _, own in groupby(points, key=lambda p: p.calibration)]
    charts = [
        (own, individuals_chart([p.value for p in own], last["low"], last["high"])) for own in stretches
    ]
    return Series(name, last["unit"], last["low"], last["high"], tuple(charts), missing)


def _calibration(tree: Mapping[str, Any]) -> str:
    """Return a label of a calibration; equal versions with different content get different labels."""
    found = tree["calibration"]
    return "none" if not found else f"version {found['version']} ({found['sha256'][:6]})"
