"""How firmly the robot was pressed on its wall during a run: a figure of every procedure's report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.interfaces import Sink
from hil.vocabulary.signals import CycleRecord

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVERY_NS = nanoseconds(0.1)
_MOST = 4096
CAPTION = (
    "The smaller of what load cells and fan say, what holds the robot at its heading, and the friction that "
    "the most loaded wheel uses. Benches that were opened one after the other follow each other."
)

Row = tuple[float, float, float, float]


class HoldHistory(Sink):
    """Takes force, need and the most friction in use, ten times a second, from bench after bench."""

    def __init__(self) -> None:
        self._rows: list[Row] = []
        self._next_ns = self._last_ns = 0
        self._driven_s = 0.0
        self._thin = 1

    def write(self, record: CycleRecord) -> None:
        """Take one record."""
        figures, t_ns = record.state.diagnostics, record.inputs.t_ns
        if t_ns < self._last_ns:
            self._next_ns = t_ns
        if t_ns < self._next_ns or "adhesion_n" not in figures:
            return
        step_s = min(max(t_ns - self._last_ns, 0), 2 * self._thin * _EVERY_NS) / NS_PER_S
        self._driven_s += step_s
        self._last_ns, self._next_ns = t_ns, t_ns + self._thin * _EVERY_NS
        used = max((v for k, v in figures.items() if k.startswith("utilisation_")), default=math.nan)
        self._rows.append((self._driven_s, figures["adhesion_n"], figures["adhesion_needed_n"], used))
        if len(self._rows) > _MOST:
            self._rows, self._thin = self._rows[::2], 2 * self._thin

    def close(self) -> None:
        """Nothing to let go of; the next bench goes on."""

    def figure(self) -> Figure | None:
        """Force and need, and friction in use, over the time driven; None where nobody measured."""
        from hil.report.run_plots import SERIES, legend, new_figure, style

        if len(self._rows) < 2:
            return None
        t_s, force_n, needed_n, used = zip(*self._rows, strict=True)
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
