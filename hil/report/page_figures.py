"""Embeds figures of a run as images of a page: they follow its theme and font, but run no script.

A results folder may come from an untrusted source. As an `<img>`, any SVG is only drawn: it runs no script,
loads nothing and follows no link. Its readings are added separately as validated numbers
(`hil.report.hover_data`), for the page's own script.
"""

from __future__ import annotations

import base64
import io
import re
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

from markupsafe import Markup

from hil.core.errors import DataError, reason_of
from hil.report.hover_data import readings_of, taken_out
from hil.report.plot_style import PALETTE
from hil.support.file_reading import read_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_BYTES = 64 << 20
_PX_PER_PT = 1.6
_PT_PER_IN = 72.0
"""Resolution of SVG, at which matplotlib measures texts."""
_GAP_PT, _MOST_STEPS = 4.0, 9
_INK, _DARK_INK = "#18181b", "#ececf0"
_LIGHT = {
    "reference": "#71717a",
    "truth": "#18181b",
    "c1": "#2563eb",
    "c2": "#c76a06",
    "c3": "#047857",
    "c4": "#7e22ce",
    "c5": "#c81e1e",
    "grid": "#e4e4e7",
}
_DARK = {
    "reference": "#9d9da8",
    "truth": "#f4f4f5",
    "c1": "#6ea8ff",
    "c2": "#f5a94a",
    "c3": "#4ade9c",
    "c4": "#c79bff",
    "c5": "#ff7b72",
    "grid": "#2c2c33",
}


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as SVG with readings; return the path. Equal figures give equal bytes.

    Raises:
        OSError: the file cannot be written.
    """
    path.write_text(_drawn(figure, path.stem), encoding="utf-8")
    return path


def _drawn(figure: Figure, name: str) -> str:
    """Return the SVG of a figure with its readings; `name` seeds its identifiers."""
    import matplotlib as mpl

    drawn = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        _lay_out(figure)
        figure.savefig(drawn, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    head, found, rest = drawn.getvalue().rpartition("</svg>")
    return head + readings_of(figure) + found + rest


def _lay_out(figure: Figure) -> None:
    """Lay out the axes once: otherwise `savefig` would draw the whole figure an extra time for this."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    engine = figure.get_layout_engine()
    if engine is not None and figure.axes:
        FigureCanvasSVG(figure)
        figure.set_dpi(_PT_PER_IN)
        engine.execute(figure)
        for axes in figure.axes:
            _part_labels(axes)
        figure.set_layout_engine(None)


def _part_labels(axes: Axes) -> None:
    """Reduce the ticks along a narrow x axis until no labels touch."""
    from matplotlib.ticker import AutoLocator, MaxNLocator

    if not isinstance(axes.xaxis.get_major_locator(), AutoLocator):
        return
    for most in range(_MOST_STEPS, 1, -1):
        low, high = sorted(axes.get_xlim())
        boxes = sorted(
            (t.get_window_extent() for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high),
            key=lambda box: box.x0,
        )
        if all(right.x0 - left.x1 >= _GAP_PT for left, right in pairwise(boxes)):
            return
        axes.xaxis.set_major_locator(MaxNLocator(most - 1, steps=[1, 2, 2.5, 5, 10]))


def figure_image(path: Path, title: str) -> Markup:
    """Return an SVG file as a self-contained `<img>`, in a box with its readings.

    Args:
        path: the SVG file.
        title: alternative text of the figure.

    Raises:
        DataError: the file is missing or not an SVG.
    """
    return _image(themed_svg(path), title)


def drawn_image(figure: Figure, title: str, name: str = "figure") -> Markup:
    """Return `figure_image` of a figure that was just drawn, without a file; `name` seeds its identifiers."""
    return _image(_themed(_drawn(figure, name), name), title)


def _image(themed: str, title: str) -> Markup:
    svg, readings = taken_out(themed)
    width = re.search(r'\bwidth="(\d{1,5}(?:\.\d*)?)pt"', svg.split(">", 1)[0])
    limit = Markup(' style="max-width:{}px"').format(round(float(width[1]) * _PX_PER_PT)) if width else ""
    data = base64.b64encode(svg.encode("utf-8", "replace")).decode("ascii")
    known = Markup(' data-readings="{}"').format(readings) if readings else ""
    image = Markup('<img alt="{}" src="data:image/svg+xml;base64,{}">').format(title, data)
    return Markup('<div class="plot"{}{}>{}</div>').format(limit, known, image)


def themed_svg(path: Path) -> str:
    """Return an SVG file without prolog, with the colours of the reader's light or dark theme.

    Raises:
        DataError: the file is missing or not an SVG.
    """
    try:
        text = read_text(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None
    return _themed(text, str(path))


def _themed(text: str, source: str) -> str:
    """`themed_svg` of a text; errors name `source`."""
    start, end = text.find("<svg"), text.rfind("</svg>")
    if start < 0 or end < start:
        raise DataError(source, "is not an SVG file")
    text = text[start:end]
    for name, colour in PALETTE.items():
        text = re.sub(re.escape(colour), f"var(--{name})", text, flags=re.I)
    text = re.sub(r"#000000|(?<=fill: )black", "currentColor", text)
    text = re.sub(r"<text(?=[ >])", '<text fill="currentColor"', text)
    whole = f"{text}<style>{_style()}</style></svg>"
    try:
        expat.ParserCreate().Parse(whole, True)
    except (expat.ExpatError, ValueError) as error:
        raise DataError(source, f"is not an SVG file ({error})") from None
    return whole


def theme() -> dict[str, str]:
    """Return the colours of figures as CSS variables, for `light` and `dark` pages."""
    return {
        name: "".join(f"--{k}:{v};" for k, v in colours.items())
        for name, colours in (("light", _LIGHT), ("dark", _DARK))
    }


def _style() -> str:
    own = theme()
    return (
        f":root{{color:{_INK};{own['light']}}}"
        f"@media (prefers-color-scheme: dark){{:root{{color:{_DARK_INK};{own['dark']}}}}}"
        "text{font-family:system-ui,sans-serif !important}"
    )
