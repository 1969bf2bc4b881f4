"""Paths of the robot during a run: a figure in reports of procedures that draw no figures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.report.figure_rows import DrivenRows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVERY_NS = nanoseconds(0.05)
_DRIVEN_M = 0.01
_WIDTHS = {"reference": 4.2, "estimate": 2.2, "truth": 0.9}
"""Widths of the lines, pt: where they lie on each other, all are seen."""
_NOWHERE = (math.nan, math.nan)
CAPTION = (
    "Above: where the robot was meant to be, where the estimate had it, and where it was. Below: how far "
    "two of them are apart. Benches that were opened one after the other follow each other."
)


class PathHistory(Sink):
    """Collects reference, estimate and true position, twenty times a second, across all benches of a run.

    The true position is that of the emulated robot if it lives in this process, else of motion capture.
    The estimate is left out where nothing is asked of the wheels: it may have begun anywhere then.
    """

    def __init__(self) -> None:
        self._driven = DrivenRows(_EVERY_NS)

    def write(self, record: CycleRecord) -> None:
        """Add one record."""
        t_ns = record.inputs.t_ns
        if self._driven.begin_anew(t_ns):
            self._driven.interrupt(*_NOWHERE, *_NOWHERE, *_NOWHERE)
        if not self._driven.is_due(t_ns):
            return
        reference = _NOWHERE if record.reference is None else _position(record.reference.pose_in_wall)
        asked = record.reference is not None or record.setpoint.wheel_rate_rad_s.any()
        estimate = _position(record.state.pose_body_in_wall) if asked else _NOWHERE
        self._driven.add(t_ns, *reference, *estimate, *_true_position(record))

    def follow(self, later: PathHistory) -> None:
        """Append the history of benches that were driven in another process."""
        self._driven.interrupt(*_NOWHERE, *_NOWHERE, *_NOWHERE)
        self._driven.follow(later._driven)

    def close(self) -> None:
        """Do nothing; the next bench continues the history."""

    def figure(self) -> Figure | None:
        """Draw the paths in the wall plane, and their distances over driven time; None without a drive."""
        from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style

        if len(self._driven.rows) < 2:
            return None
        rows = np.array(self._driven.rows)
        paths = {"reference": rows[:, 1:3], "estimate": rows[:, 3:5], "truth": rows[:, 5:7]}
        paths = {name: path for name, path in paths.items() if np.isfinite(path).any()}
        sizes = (np.ptp(path[np.isfinite(path[:, 0])], axis=0) for path in paths.values())
        if max((float(np.max(size)) for size in sizes), default=0.0) < _DRIVEN_M:
            return None
        colours = {"reference": PALETTE["reference"], "estimate": SERIES[0], "truth": PALETTE["truth"]}
        figure = new_figure(5.2, 5.0)
        axes = style(figure.add_subplot(2, 1, 1), "Y, left (m)", "X (m)")
        for name in ("reference", "estimate", "truth"):  # wide below narrow: none hides another
            if name in paths:
                path = paths[name]
                axes.plot(path[:, 1], path[:, 0], color=colours[name], lw=_WIDTHS[name], label=name)
        axes.set_aspect("equal", adjustable="datalim")
        axes.invert_xaxis()
        legend(axes)
        self._draw_distances(figure, rows[:, 0], paths)
        return figure

    @staticmethod
    def _draw_distances(figure: Figure, t_s: Array, paths: dict[str, Array]) -> None:
        from hil.report.plot_style import SERIES, legend, style

        pairs = [
            (a, b)
            for a, b in (("truth", "reference"), ("estimate", "truth"), ("estimate", "reference"))
            if a in paths and b in paths
        ][:2]
        axes = style(figure.add_subplot(2, 1, 2), "time driven (s)", "distance (mm)")
        for (a, b), colour in zip(pairs, SERIES[1:], strict=False):
            apart_mm = 1e3 * np.linalg.norm(paths[a] - paths[b], axis=1)
            axes.plot(t_s, apart_mm, color=colour, lw=1.3, label=f"{a} to {b}")
        axes.set_ylim(bottom=0.0)
        legend(axes)


def _position(pose: Array) -> tuple[float, float]:
    return float(pose[0]), float(pose[1])


def _true_position(record: CycleRecord) -> tuple[float, float]:
    if record.truth is not None:
        return _position(record.truth["pose_body_in_wall"])
    seen = [m.pose for m in record.measurements.mocap if m.valid]
    return _position(seen[-1]) if seen else _NOWHERE
