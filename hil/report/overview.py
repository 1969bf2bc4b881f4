"""A page of results that are no run of a procedure: a sentence, warnings, figures, tables."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.report.figures import figure_image, save_figure
from hil.report.pages import environment
from hil.vocabulary.files import staged, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawn:
    """A figure with its file name (without ending), title and caption."""

    name: str
    title: str
    figure: Figure
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of text under a head of as many labels; `open` ones are not folded."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    open: bool = True


@dataclass(frozen=True)
class Overview:
    """What a page says, in its order: `sentence` is what happened."""

    title: str
    sentence: str
    figures: Sequence[Drawn]
    tables: Sequence[Table]
    warnings: Sequence[str] = ()
    facts: Sequence[str] = ()


def write_overview(path: Path, page: Overview) -> Path:
    """Write the page as one file; returns its path.

    Raises:
        DataError: it cannot be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        return write_text(path, _text(page, Path(folder)))


def write_overview_folder(folder: Path, page: Overview) -> Path:
    """Write `index.html` and each figure as SVG into a folder, all or nothing; returns the page's path.

    Raises:
        DataError: they cannot be written.
    """
    with staged(folder) as parts:
        write_text(parts / "index.html", _text(page, parts))
    return folder / "index.html"


def _text(page: Overview, folder: Path) -> str:
    images = [
        (d.title, figure_image(save_figure(d.figure, folder / f"{d.name}.svg"), d.title), d.caption)
        for d in page.figures
    ]
    return environment().get_template("overview.html").render(page=page, images=images)
