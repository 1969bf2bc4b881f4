"""Look of the figures in reports of runs: one palette that works on light and on dark pages.

Colours of the palette are replaced by the page's own when a figure is put into a report, so that
the same SVG reads well alone on white and in a dark report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.vocabulary.geometry import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE: Mapping[str, str] = {
    "reference": "#71717b",
    "truth": "#18181c",
    "c1": "#2563ea",
    "c2": "#d97707",
    "c3": "#059668",
    "c4": "#9333eb",
    "c5": "#dc2627",
    "grid": "#d4d4d9",
}
SERIES = tuple(PALETTE[f"c{k}"] for k in range(1, 6))
_POINTS = 400


def new_figure(width_in: float = 5.2, height_in: float = 3.0) -> Figure:
    """An empty figure; its text stays text, in the reader's font."""
    from matplotlib.figure import Figure  # takes 0.7 s, which a run that draws nothing should not wait

    return Figure(figsize=(width_in, height_in), layout="constrained")


def style(axes: Axes, x: str, y: str, title: str = "") -> Axes:
    """Labels, a quiet grid, no frame on top and right.

    Args:
        axes: to draw on.
        x: label with unit; empty for none.
        y: the same.
        title: empty for none.
    """
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8, length=3)
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(color=PALETTE["grid"], lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return axes


def plain_log(axes: Axes, linear_below: float | None = None) -> None:
    """A logarithmic y axis labelled 1, 10, 100; linear around zero where `linear_below` is given."""
    if linear_below is None:
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=linear_below)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def legend(axes: Axes, columns: int = 1, *, above: bool = False) -> None:
    """A legend without box: where there is room, or above the axes, where it hides no curve."""
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)} if above else {}
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, ncols=columns, **place)


def thin(*columns: Array) -> list[Array]:
    """Columns (n,) of one length, thinned to what a figure can show."""
    step = max(1, len(columns[0]) // _POINTS)
    return [np.append(c[:-1:step], c[-1:]) for c in columns]


def bars(names: Sequence[str], values: Sequence[float], y: str, limit: float | None = None) -> Figure:
    """One bar per name, with a line at the limit.

    Args:
        names: one per bar.
        values: one per bar.
        y: label with unit.
        limit: of the absolute value; None for none.
    """
    figure = new_figure(max(3.4, 1.0 + 0.6 * len(names)), 2.6)
    axes = style(figure.add_subplot(), "", y)
    over = [limit is not None and abs(v) > limit for v in values]
    axes.bar(
        range(len(names)), values, color=[PALETTE["c5"] if o else PALETTE["c1"] for o in over], width=0.65
    )
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=30 if max(map(len, names)) > 6 else 0)
    if limit is not None:
        axes.axhline(limit, color=PALETTE["c5"], lw=1.0, ls="--")
    return figure
