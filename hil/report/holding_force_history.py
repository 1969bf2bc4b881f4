"""Holding force of the robot on its wall during a run: a figure of every procedure's report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hil.core.clock import nanoseconds
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.report.figure_rows import DrivenRows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVERY_NS = nanoseconds(0.1)
CAPTION = (
    "The smaller of what load cells and fan say, what holds the robot at its heading, and the friction that "
    "the most loaded wheel uses. Benches that were opened one after the other follow each other."
)


class HoldHistory(Sink):
    """Collects force, needed force and highest friction use, ten times a second, across all benches."""

    def __init__(self) -> None:
        self._driven = DrivenRows(_EVERY_NS)

    def write(self, record: CycleRecord) -> None:
        """Add one record."""
        figures, t_ns = record.state.diagnostics, record.inputs.t_ns
        self._driven.begin_anew(t_ns)
        if not self._driven.is_due(t_ns) or "adhesion_n" not in figures:
            return
        used = max((v for k, v in figures.items() if k.startswith("utilisation_")), default=math.nan)
        self._driven.add(t_ns, figures["adhesion_n"], figures["adhesion_needed_n"], used)

    def follow(self, later: HoldHistory) -> None:
        """Append the history of benches that were driven in another process."""
        self._driven.follow(later._driven)

    def close(self) -> None:
        """Do nothing; the next bench continues the history."""

    def figure(self) -> Figure | None:
        """Draw force, needed force and friction use over driven time; None without a measurement."""
        from hil.report.plot_style import SERIES, legend, new_figure, style

        if len(self._driven.rows) < 2:
            return None
        t_s, force_n, needed_n, used = zip(*self._driven.rows, strict=True)
        figure = new_figure(5.2, 3.4)
        axes = style(figure.add_subplot(2, 1, 1), "", "force (N)")
        axes.plot(t_s, force_n, color=SERIES[0], lw=1.3, label="measured")
        axes.plot(t_s, needed_n, color=SERIES[4], lw=1.3, label="needed")
        axes.fill_between(t_s, needed_n, force_n, color=SERIES[0], alpha=0.12, label="margin")
        axes.set_ylim(bottom=0.0)
        legend(axes, columns=3)
        axes = style(figure.add_subplot(2, 1, 2), "time driven (s)", "friction in use (%)")
        axes.plot(t_s, [100.0 * u for u in used], color=SERIES[1], lw=1.3)
        axes.set_ylim(0.0, 100.0)
        return figure
