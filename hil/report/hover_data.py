"""The data of a figure for its cross-hair: axes and thinned series, stored inside the SVG file.

A page draws these data again for a cross-hair and for enlarged parts. They are extracted when the figure is
saved, and validated when they are read, since a results folder may come from an untrusted source.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.core.geometry import Array
from hil.report.plot_style import MOST_POINTS, PALETTE, kept_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text
    from matplotlib.transforms import Transform

_DIGITS = 5
_PICTURES = ("AxesImage", "QuadMesh", "Quiver", "FancyArrowPatch")
_KEPT = re.compile(r'<metadata id="readings">(.*?)</metadata>', re.S)

_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Text = Annotated[str, Field(max_length=200)]
_Colour = Annotated[str, Field(pattern=r"^(#[0-9a-f]{6}|truth|reference|grid|c[1-5])$")]
_Points = Annotated[list[_Number | None], Field(max_length=2 * MOST_POINTS)]
_Box = tuple[_Number, _Number, _Number, _Number]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Scale(_Part):
    """One axis: label with unit, limits, the box of its tick labels, and names instead of numbers."""

    label: _Text
    limits: tuple[_Number, _Number]
    log: bool = False
    linear_below: _Number | None = None
    """Linear range of a symmetric logarithmic scale."""
    strip: _Box | None = None
    names: Annotated[dict[_Text, _Text], Field(max_length=MOST_POINTS)] = {}


class Curve(_Part):
    """Points of one series: drawn as a line or marks; shown by the cross-hair if the series has a name."""

    name: _Text = ""
    colour: _Colour
    x: _Points
    y: _Points
    width: _Number = 0.0
    dashed: bool = False
    mark: bool = False
    across: bool = False
    """True if x holds the values and y the positions, as for horizontal bars."""


class Area(_Part):
    """A filled polygon of a figure."""

    colour: _Colour
    x: _Points
    y: _Points
    opacity: _Number


class Readings(_Part):
    """One pair of axes: box (left, top, width, height) in pt from the figure's corner, and its contents."""

    title: _Text = ""
    box: _Box
    x: Scale
    y: Scale
    zoom: bool = True
    series: Annotated[list[Curve], Field(max_length=100)] = []
    areas: Annotated[list[Area], Field(max_length=200)] = []


class _Figure(_Part):
    size: tuple[_Number, _Number]
    axes: Annotated[list[Readings], Field(max_length=40)]


def readings_of(figure: Figure) -> str:
    """Return the readings of a figure that was just saved, as an SVG element; empty without readings."""
    try:
        axes = [Readings.model_validate(found) for found in _all_axes(figure)]
        text = as_json(_size_pt(figure), *axes)
    except (ValueError, ArithmeticError):
        return ""
    return f'<metadata id="readings">{html.escape(text)}</metadata>'


def as_json(size_pt: tuple[float, float], *axes: Readings) -> str:
    """Return the readings of a figure of this width and height, as JSON for the page's script."""
    whole = _Figure(size=size_pt, axes=list(axes))
    return json.dumps(whole.model_dump(exclude_defaults=True), separators=(",", ":"))


def taken_out(svg: str) -> tuple[str, str]:
    """Split an SVG into drawing and readings (JSON); readings are empty if missing or invalid."""
    found = _KEPT.search(svg)
    if found is None:
        return svg, ""
    try:
        whole = _Figure.model_validate_json(html.unescape(found[1]))
        text = as_json(whole.size, *whole.axes)
    except ValidationError:
        text = ""
    return _KEPT.sub("", svg), text


def _size_pt(figure: Figure) -> tuple[float, float]:
    width, height = figure.get_size_inches()
    return 72.0 * float(width), 72.0 * float(height)


def _all_axes(figure: Figure) -> Iterator[dict[str, Any]]:
    for axes in figure.axes:
        if axes.get_label() == "<colorbar>" or not axes.get_visible():
            continue
        series, areas = list(_series(axes)), list(_areas(axes))
        if series or areas:
            yield {
                "title": axes.get_title(loc="left") or axes.get_title(),
                "series": series,
                "areas": areas,
                "box": _box(figure, axes.get_window_extent()),
                "zoom": not _pictures(axes),
                "x": _scale(figure, axes.xaxis, axes.get_xlim()),
                "y": _scale(figure, axes.yaxis, axes.get_ylim()),
            }


def _pictures(axes: Axes) -> list[Any]:
    """Return artists that are images: they cannot be drawn again from data."""
    found = [*axes.images, *axes.collections, *axes.patches]
    arrows = [text for text in axes.texts if getattr(text, "arrow_patch", None) is not None]
    return [a for a in found if type(a).__name__ in _PICTURES] + arrows


def _box(figure: Figure, extent: Any) -> tuple[float, float, float, float]:
    """Convert a display box to (left, top, width, height) in pt from the figure's upper left corner."""
    per_px = 72.0 / figure.dpi
    height = 72.0 * float(figure.get_size_inches()[1])
    values = (per_px * extent.x0, height - per_px * extent.y1, per_px * extent.width, per_px * extent.height)
    return tuple(round(float(v), 1) for v in values)  # type: ignore[return-value]


def _scale(figure: Figure, axis: Axis, limits: tuple[float, float]) -> dict[str, Any]:
    from matplotlib.ticker import FixedLocator
    from matplotlib.transforms import Bbox

    labels = axis.get_ticklabels()
    shown = [t for t in labels if t.get_visible() and t.get_text()]
    boxes = [t.get_window_extent() for t in shown]
    named = isinstance(axis.get_major_locator(), FixedLocator) and any(map(_is_word, shown))
    places = zip(axis.get_ticklocs(), labels, strict=False) if named else ()
    return {
        "label": axis.get_label_text(),
        "limits": (float(limits[0]), float(limits[1])),
        "log": axis.get_scale() == "log",
        "linear_below": getattr(axis.get_transform(), "linthresh", None),
        "strip": _box(figure, Bbox.union(boxes)) if boxes else None,
        "names": {f"{at:g}": t.get_text() for at, t in places if t.get_text()},
    }


def _is_word(label: Text) -> bool:
    return any(letter.isalpha() for letter in label.get_text())


def _series(axes: Axes) -> Iterator[dict[str, Any]]:
    for line in axes.lines:
        yield from _of_line(axes, line)
    for collection in axes.collections:
        kind, colours = type(collection).__name__, collection.get_edgecolor()
        if kind == "LineCollection":
            ways = [np.vstack([p.vertices, [[np.nan, np.nan]]]) for p in collection.get_paths()]
            if ways:
                x, y = _in_data(axes, collection.get_transform(), np.vstack(ways))
                width = float(np.atleast_1d(collection.get_linewidth())[0])
                yield {"colour": _colour(colours[0]), "x": x, "y": y, "width": width}
        elif kind == "PathCollection":
            x, y = _in_data(axes, collection.get_offset_transform(), np.asarray(collection.get_offsets()))
            name = str(collection.get_label())
            yield {
                "name": "" if name.startswith("_") else name,
                "x": x,
                "y": y,
                "mark": True,
                "colour": _colour(collection.get_facecolor()[0]),
            }
    for bars in axes.containers:
        yield from _of_bars(bars)


def _of_line(axes: Axes, line: Line2D) -> Iterator[dict[str, Any]]:
    name = str(line.get_label())
    x, y = _in_data(axes, line.get_transform(), np.asarray(line.get_xydata()))
    drawn = line.get_linestyle() not in ("None", "", " ")
    marked = line.get_marker() not in ("None", "", " ", None)
    if x and (drawn or marked):
        yield {
            "name": "" if name.startswith("_") else name,
            "colour": _colour(line.get_color()),
            "x": x,
            "y": y,
            "width": float(line.get_linewidth()) if drawn else 0.0,
            "mark": marked,
            "dashed": drawn and line.get_linestyle() not in ("-", "solid"),
        }


def _of_bars(bars: Any) -> Iterator[dict[str, Any]]:
    """Yield the ends of bars for readings; the bars themselves are drawn as areas."""
    if type(bars).__name__ != "BarContainer" or not len(bars):
        return
    lying = bars.orientation == "horizontal"
    places = [p.get_y() + p.get_height() / 2 if lying else p.get_x() + p.get_width() / 2 for p in bars]
    ends = [p.get_width() if lying else p.get_height() for p in bars]
    name = str(bars.get_label() or "")
    places, ends = (_rounded(np.array(v, float)) for v in (places, ends))
    yield {
        "name": "" if name.startswith("_") else name,
        "colour": _colour(bars[0].get_facecolor()),
        "x": ends if lying else places,
        "y": places if lying else ends,
        "across": lying,
    }


def _areas(axes: Axes) -> Iterator[dict[str, Any]]:
    from matplotlib.collections import PolyCollection

    for patch in axes.patches:
        colour = np.array(patch.get_facecolor())
        if patch.get_fill() and colour[3] > 0.0 and type(patch).__name__ not in _PICTURES:
            x, y = _in_data(axes, patch.get_transform(), np.asarray(patch.get_path().vertices))
            yield {"colour": _colour(colour), "x": x, "y": y, "opacity": float(colour[3])}
    for collection in axes.collections:
        if isinstance(collection, PolyCollection) and type(collection).__name__ not in _PICTURES:
            colours = np.atleast_2d(np.array(collection.get_facecolor()))
            for path in collection.get_paths() if colours.size else ():
                x, y = _in_data(axes, collection.get_transform(), np.asarray(path.vertices))
                yield {"colour": _colour(colours[0]), "x": x, "y": y, "opacity": float(colours[0][3])}


def _in_data(
    axes: Axes, transform: Transform, points: Array
) -> tuple[list[float | None], list[float | None]]:
    """Convert points (n, 2) of an artist to data coordinates, thinned; None where a line breaks."""
    if not len(points):
        return [], []
    points = np.ma.filled(np.ma.asarray(points, float), np.nan)
    kept = points[kept_rows(*points.T)]
    with np.errstate(all="ignore"):
        data = (transform - axes.transData).transform(kept)
    return _rounded(data[:, 0]), _rounded(data[:, 1])


def _rounded(values: Array) -> list[float | None]:
    """Round values to the precision of a reading; None for non-finite values."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    largest = float(np.abs(known).max()) if len(known) else 0.0
    size = span or largest or 1.0
    digits = int(np.clip(_DIGITS - np.ceil(np.log10(size)), 0, 12))
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]


def _colour(colour: Any) -> str:
    from matplotlib.colors import to_hex

    plain = to_hex(colour)
    return next((name for name, own in PALETTE.items() if own == plain), plain)
