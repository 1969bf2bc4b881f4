"""Style of the figures in reports of runs: one palette for light and dark pages.

The palette is replaced by the page's colours when a figure is embedded in a report, so that the same
SVG is readable both alone on white and in a dark report.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.core.geometry import Array

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
_STRAIGHT = 0.1
_FINE, _DECADES = (1.0, 2.0, 5.0), (1.0,)
MOST_POINTS = 400
"""Largest number of points of one curve."""


def new_figure(width_in: float = 5.2, height_in: float = 3.0) -> Figure:
    """Return an empty figure; its text is saved as text, in the reader's font."""
    from matplotlib.figure import Figure  # takes 0.7 s, not needed in a run without figures

    return Figure(figsize=(width_in, height_in), layout="constrained")


def style(axes: Axes, x: str, y: str, title: str = "") -> Axes:
    """Set labels and a light grid; remove the top and right frame.

    Args:
        axes: axes to change.
        x: label with unit; empty for none.
        y: label with unit; empty for none.
        title: title; empty for none.
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
    """Set a logarithmic y axis labelled 1, 10, 100 for the data drawn so far.

    Args:
        axes: axes with all data.
        linear_below: value up to which the axis is linear, if given; fully linear if no data exceed it.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, SymmetricalLogLocator

    low, high = axes.dataLim.intervaly
    most = max(-low, high)
    if linear_below is not None and most <= linear_below:
        return
    if linear_below is None or low > linear_below:
        axes.set_yscale("log")
        subs = _FINE if most <= 100.0 * axes.dataLim.minposy else _DECADES
        axes.yaxis.set_major_locator(LogLocator(subs=subs))
    else:
        axes.set_yscale("symlog", linthresh=linear_below)
        subs = _FINE if most <= 10.0 * linear_below else _DECADES
        axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10.0, linthresh=linear_below, subs=subs))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.7g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def share_scale(axes: Axes, x_m: float, y_m: float) -> None:
    """Use one scale for x and y of a path, unless it runs along one axis, where curves would overlap.

    Args:
        axes: axes of the path.
        x_m: extent of the path along X, m.
        y_m: extent of the path along Y, m.
    """
    if min(x_m, y_m) > _STRAIGHT * max(x_m, y_m):
        axes.set_aspect("equal", adjustable="datalim")


def legend(axes: Axes, columns: int = 1, *, above: bool = False) -> None:
    """Add a legend without box: at the best free place, or above the axes, where it hides no curve."""
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)} if above else {}
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, ncols=columns, **place)


def thin(*columns: Array) -> list[Array]:
    """Thin columns (n,) of equal length for a figure; extremes are kept, see `kept_rows`."""
    rows = kept_rows(*columns)
    return [c[rows] for c in columns]


def kept_rows(*columns: Array, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return indices of rows that represent a curve: regular ones, and extremes and gaps of each section.

    Args:
        columns: (n,) each, of equal length. Extremes of a monotonic one, such as time, lie at its ends.
        most: largest number of rows.
    """
    count = len(columns[0])
    if count <= most:
        return np.arange(count)
    known = [np.isfinite(c) for c in columns]
    lowest = [
        np.where(k, sign * np.where(k, c, 0.0), np.inf)
        for c, k in zip(columns, known, strict=True)
        if not np.all(np.diff(c) >= 0.0)
        for sign in (1.0, -1.0)
    ]
    if not np.all(known):
        lowest.append(np.all(known, axis=0).astype(np.float64))
    kept = np.linspace(0, count - 1, most // 2).round().astype(np.intp)
    if lowest:
        edges = np.linspace(0, count, max(1, most // 2 // len(lowest)) + 1).astype(np.intp)
        found = [a + np.argmin(v[a:b]) for v in lowest for a, b in pairwise(edges)]
        kept = np.append(kept, found)
    return np.unique(kept)
