"""Figures of a run as images of a page: they follow its theme and font, and can do nothing else.

A results folder may come from anywhere. As an `<img>` an SVG runs no script, loads nothing and follows no
link, whatever it holds; only its drawing is shown.
"""

from __future__ import annotations

import base64
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

from markupsafe import Markup

from hil.report.run_plots import PALETTE
from hil.vocabulary.errors import DataError
from hil.vocabulary.reading import read_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_BYTES = 64 << 20
_PX_PER_PT = 1.35
_INK, _DARK_INK = "#18181b", "#ececf0"
_LIGHT = {
    "reference": "#71717a", "truth": "#18181b", "c1": "#2563eb", "c2": "#c76a06", "c3": "#047857",
    "c4": "#7e22ce", "c5": "#c81e1e", "grid": "#e4e4e7",
}  # fmt: skip
_DARK = {
    "reference": "#9d9da8", "truth": "#f4f4f5", "c1": "#6ea8ff", "c2": "#f5a94a", "c3": "#4ade9c",
    "c4": "#c79bff", "c5": "#ff7b72", "grid": "#2c2c33",
}  # fmt: skip


def figure_image(path: Path, title: str) -> Markup:
    """An SVG file as an `<img>` that needs no other file.

    Args:
        path: of the SVG file.
        title: what stands for the figure where it cannot be seen.

    Raises:
        DataError: the file is missing or no SVG.
    """
    svg = themed_svg(path)
    width = re.search(r'\bwidth="(\d{1,5}(?:\.\d*)?)pt"', svg.split(">", 1)[0])
    limit = Markup(' style="max-width:{}px"').format(round(float(width[1]) * _PX_PER_PT)) if width else ""
    data = base64.b64encode(svg.encode("utf-8", "replace")).decode("ascii")
    return Markup('<img alt="{}"{} src="data:image/svg+xml;base64,{}">').format(title, limit, data)


def drawn_image(figure: Figure, title: str) -> Markup:
    """A figure that was just drawn, as `figure_image` of its file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figure.svg"
        figure.savefig(file)
        return figure_image(file, title)


def themed_svg(path: Path) -> str:
    """An SVG file without prolog, its colours those of the reader's light or dark theme.

    Raises:
        DataError: the file is missing or no SVG.
    """
    try:
        text = read_text(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({error})") from None
    start, end = text.find("<svg"), text.rfind("</svg>")
    if start < 0 or end < start:
        raise DataError(str(path), "is not an SVG file")
    text = text[start:end]
    for name, colour in PALETTE.items():
        text = re.sub(re.escape(colour), f"var(--{name})", text, flags=re.I)
    text = re.sub(r"#000000|(?<=fill: )black", "currentColor", text)
    text = re.sub(r"<text(?=[ >])", '<text fill="currentColor"', text)
    whole = f"{text}<style>{_style()}</style></svg>"
    try:
        expat.ParserCreate().Parse(whole, True)
    except (expat.ExpatError, ValueError) as error:
        raise DataError(str(path), f"is not an SVG file ({error})") from None
    return whole


def _style() -> str:
    def theme(ink: str, colours: dict[str, str]) -> str:
        return ":root{" + f"color:{ink};" + "".join(f"--{k}:{v};" for k, v in colours.items()) + "}"

    return (
        theme(_INK, _LIGHT)
        + "@media (prefers-color-scheme: dark){" + theme(_DARK_INK, _DARK) + "}"
        + "text{font-family:system-ui,sans-serif !important}"
    )  # fmt: skip
