"""The page of a comparison of recorded and emulated runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from hil.report.overview import Drawn, Overview, Table, write_overview
from hil.report.page_formats import number
from hil.report.plot_style import PALETTE, legend, new_figure, style
from hil.twin.compare import CONTROL, LIMIT, Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ALIKE = {True: "alike", False: "told apart", None: "no control"}


def write_twin_page(path: Path, title: str, found: Comparison) -> Path:
    """Write the page; return its path.

    Args:
        path: HTML file.
        title: heading.
        found: the comparison.

    Raises:
        DataError: the file cannot be written.
    """
    signals = [[s.group, number(s.auc), number(s.control), _ALIKE[s.alike]] for s in found.signals]
    figures = [
        [f.motion, f.name, f.unit, *(number(v) for v in (f.recorded, f.low, f.high)), _place(f.inside)]
        for f in found.figures
    ]
    tables = [
        Table("Signals", ["group", "AUC", "control", ""], signals, _NOTE),
        Table(
            "End error of nominal odometry",
            ["motion", "direction", "unit", "recorded", "least", "most", ""],
            figures,
            "The mean of the recorded runs, and the interval in which 90 % of emulated runs lie.",
        ),
    ]
    drawn = Drawn("signals", "Signals", _drawn(found), "Dashed: the largest AUC that passes.")
    return write_overview(path, Overview(title, sentence(found), [drawn], tables))


_NOTE = (
    "How well a classifier tells recorded from emulated windows, on motions that it has not seen: 0.5 is "
    "chance, 1 certainty. Control: repetitions of the recorded robot against each other."
)


def sentence(found: Comparison) -> str:
    """Summary: how many figures lie in their intervals, and which groups of signals are told apart."""
    inside = sum(f.inside for f in found.figures)
    text = f"{inside} of {len(found.figures)} figures lie in their intervals."
    apart = [s.group for s in found.signals if s.alike is False]
    doubtful = [s.group for s in found.signals if s.alike is None]
    if apart:
        text += f" Told apart, with an AUC above {LIMIT:g}: {', '.join(apart)}."
    if doubtful:
        text += f" Without a control of at most {CONTROL:g}: {', '.join(doubtful)}."
    return text


def _place(inside: bool) -> str:
    return "inside" if inside else "outside"


def _drawn(found: Comparison) -> Figure:
    figure = new_figure(5.2, 2.8)
    axes = style(figure.add_subplot(), "", "AUC")
    for label, colour, shift, values in (
        ("recorded against emulated", "c1", -0.1, [s.auc for s in found.signals]),
        ("recorded repetitions", "c2", 0.1, [s.control for s in found.signals]),
    ):
        known = [(k + shift, v) for k, v in enumerate(values) if math.isfinite(v)]
        axes.plot(*zip(*known, strict=True), "o", ms=6, color=PALETTE[colour], label=label) if known else None
    axes.axhline(LIMIT, color=PALETTE["c5"], lw=1.0, ls="--")
    axes.set_xticks(range(len(found.signals)), [s.group for s in found.signals], fontsize=8)
    axes.set_xlim(-0.5, len(found.signals) - 0.5)
    axes.set_ylim(0.3, 1.05)
    legend(axes, columns=2, above=True)
    return figure
