"""Values of devices of other packages during a run: a figure for each of them in every procedure's report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.third_party.call_timeout import with_time_limit
from hil.core.clock import nanoseconds
from hil.core.interfaces import Sink
from hil.core.kind_figures import KindFigures
from hil.core.registry import kinds, sample_names
from hil.core.signals import CycleRecord
from hil.core.third_party_errors import OURS
from hil.report.figure_rows import DrivenRows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVERY_NS = nanoseconds(0.05)
CAPTION = "As the plots of its kind say. Benches that were opened one after the other follow each other."


class DeviceHistory(Sink):
    """Collects the figures of such devices, twenty times a second, across all benches of a run."""

    def __init__(self) -> None:
        self._figures = KindFigures(with_time_limit)
        self._driven: dict[tuple[str, str], DrivenRows] = {}
        self._names: dict[tuple[str, str], tuple[str, ...]] = {}
        self._next_ns: dict[str, int] = {}

    def write(self, record: CycleRecord) -> None:
        """Add the values of one record."""
        inputs, t_ns = record.inputs, record.inputs.t_ns
        for name in sample_names(inputs):
            kind = kinds()[name]
            if kind.package == OURS or not inputs.of(name):
                continue
            due_ns = self._next_ns.get(name, t_ns)
            if due_ns - _EVERY_NS <= t_ns < due_ns:
                continue
            self._next_ns[name] = t_ns + _EVERY_NS
            for entity, figures in self._figures(kind, inputs):
                self._add(t_ns, (name, entity), figures)

    def _add(self, t_ns: int, key: tuple[str, str], figures: Mapping[str, float]) -> None:
        names = self._names.setdefault(key, tuple(figures))
        driven = self._driven.setdefault(key, DrivenRows(_EVERY_NS))
        if driven.begin_anew(t_ns):
            driven.interrupt(*(math.nan for _ in names))
        if driven.is_due(t_ns):
            driven.add(t_ns, *(float(figures.get(name, math.nan)) for name in names))

    def follow(self, later: DeviceHistory) -> None:
        """Append the history of benches that were driven in another process."""
        for key, driven in later._driven.items():
            names = self._names.setdefault(key, later._names[key])
            if names == later._names[key]:
                self._driven.setdefault(key, DrivenRows(_EVERY_NS)).follow(driven)

    def close(self) -> None:
        """Do nothing; the next bench continues the history."""

    def figures(self) -> Iterator[tuple[str, Figure]]:
        """Draw each device's values over driven time, a plot per entity: (name of the device, figure)."""
        for name in dict.fromkeys(name for name, _ in self._driven):
            shown = [key for key in self._driven if key[0] == name and len(self._driven[key].rows) > 1]
            if shown:
                yield name, self._figure(shown)

    def _figure(self, shown: list[tuple[str, str]]) -> Figure:
        from hil.report.plot_style import SERIES, legend, new_figure, style

        figure = new_figure(5.2, 0.8 + 1.7 * len(shown))
        for place, (name, entity) in enumerate(shown, start=1):
            titles = {plot.entity: plot.title for plot in kinds()[name].plots}
            label = "time driven (s)" if place == len(shown) else ""
            axes = style(figure.add_subplot(len(shown), 1, place), label, titles.get(entity, entity))
            rows = np.array(self._driven[name, entity].rows)
            for k, series in enumerate(self._names[name, entity]):
                axes.plot(rows[:, 0], rows[:, 1 + k], color=SERIES[k % len(SERIES)], lw=1.3, label=series)
            if len(self._names[name, entity]) > 1:
                legend(axes)
        return figure
