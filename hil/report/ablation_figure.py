"""Draws the effect of each part of a robot's record: end errors of wall lines by the parts that were used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOTHING, EVERYTHING = "nothing known", "everything known"
"""Settings that are part of every ablation."""


def ablation_figure(table: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Figure:
    """Draw bars of the distance from the goal: one row per setting, one colour per line.

    Args:
        table: setting -> line -> errors with `end_m`.
    """
    names = list(table)
    cases = list(next(iter(table.values())))
    figure = new_figure(5.9, 0.98 + 0.42 * len(names))
    axes = style(figure.add_subplot(), "distance from the goal (mm)", "")
    at, height = np.arange(len(names)), 0.8 / len(cases)
    for k, case in enumerate(cases):
        ends_mm = [1e3 * table[name][case]["end_m"] for name in names]
        place = at + (k - 0.5 * (len(cases) - 1)) * height
        label = "up the wall (X line)" if case == "x_line" else "across it (Y line)"
        axes.barh(place, ends_mm, height, color=SERIES[k], label=label)
        for y, end_mm in zip(place, ends_mm, strict=True):
            axes.text(end_mm, y, f" {end_mm:.1f}", va="center", fontsize=8, color=PALETTE["truth"])
    axes.set_yticks(at, names, fontsize=9)
    axes.invert_yaxis()
    axes.set_xlim(right=axes.get_xlim()[1] * 1.08)
    legend(axes)
    return figure
