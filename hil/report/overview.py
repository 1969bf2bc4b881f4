"""A page of results that are not a run of a procedure: a sentence, warnings, figures, tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from hil.report.page_figures import drawn_image, figure_image, save_figure
from hil.report.page_formats import columns_of_words, environment
from hil.support.atomic_files import staged, write_text

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
    """A table of text: `head` has one label per column; an `open` table is not folded."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    open: bool = True


@dataclass(frozen=True)
class Overview:
    """Contents of a page, in order; `sentence` summarises the result."""

    title: str
    sentence: str
    figures: Sequence[Drawn]
    tables: Sequence[Table]
    warnings: Sequence[str] = ()
    facts: Sequence[str] = ()


def write_overview(path: Path, page: Overview) -> Path:
    """Write the page as one file; return its path.

    Raises:
        DataError: the file cannot be written.
    """
    return write_text(path, _text(page, [drawn_image(d.figure, d.title, d.name) for d in page.figures]))


def write_overview_folder(folder: Path, page: Overview) -> Path:
    """Write `index.html` and each figure as SVG into a folder, all or nothing; return the page's path.

    Raises:
        DataError: a file cannot be written.
    """
    with staged(folder) as parts:
        files = [save_figure(d.figure, parts / f"{d.name}.svg") for d in page.figures]
        images = [figure_image(file, d.title) for file, d in zip(files, page.figures, strict=True)]
        write_text(parts / "index.html", _text(page, images))
    return folder / "index.html"


def _text(page: Overview, images: Sequence[Markup]) -> str:
    shown = [(d.title, image, d.caption) for d, image in zip(page.figures, images, strict=True)]
    words = [columns_of_words(table.rows) for table in page.tables]
    return environment().get_template("overview.html").render(page=page, images=shown, words=words)
