"""The trends page: each measurement over all runs of a bench, with limits, control limits, calibrations.

The drawings are SVG markup of the page and follow its theme. As in all figures, hovering shows run and
value.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.report.history.chart import DRIFTING, OUTSIDE, STEADY, TOO_FEW
from hil.report.history.series import MISSING, Group, Series
from hil.report.hover_data import Curve, Readings, Scale, as_json
from hil.report.page_formats import environment, number, quantity
from hil.report.plot_style import MOST_POINTS
from hil.support.atomic_files import write_text

_IN_WORDS = {
    MISSING: "without a value in the newest runs",
    DRIFTING: "drifting",
    OUTSIDE: "outside their control limits",
    STEADY: "steady",
    TOO_FEW: "with too few runs to judge",
}
_WIDTH, _HEIGHT, _EDGE = 320.0, 110.0, 8.0


def write_trends_page(path: Path, found: Sequence[Group]) -> Path:
    """Write the page; return its path.

    Raises:
        DataError: the file cannot be written.
    """
    shown = [
        {"group": g, "series": [(s, drawing(s) if len(s.points) > 1 else None) for s in g.series]}
        for g in found
    ]
    template = environment().get_template("trends.html")
    page = template.render(groups=shown, headline=headline(found), width=_WIDTH, height=_HEIGHT)
    return write_text(path, page)


def headline(found: Sequence[Group]) -> str:
    """Return one sentence: whether any measurement needs attention."""
    all_series = [s for group in found for s in group.series]
    runs = sum(len(group.runs) for group in found)
    counts = Counter(s.state for s in all_series)
    if not all_series:
        return "No run that came to its end has measured anything yet."
    reported = [f"{counts[state]} {words}" for state, words in _IN_WORDS.items() if counts[state]]
    many = "s" * (len(all_series) != 1), "s" * (runs != 1)
    return f"{len(all_series)} measurement{many[0]} in {runs} run{many[1]}: {', '.join(reported)}."


def drawing(series: Series) -> dict[str, Any]:
    """Return coordinates of the drawing, in px of a picture `_WIDTH` by `_HEIGHT`; runs are equally spaced.

    Args:
        series: series with at least two values.

    Returns:
        `points` (x, y, tone, words), `lines` through the points of each stretch, `limits` (y),
        `control` (x, width, top, height, y of the centre), `calibrations` (x, words), `readings` (JSON), and
        the values at `top` and `bottom`, empty if no measured value or limit lies there.
    """
    points, reach = series.points, _span(series)
    known = {p.value for p in points} | {series.low, series.high}
    known |= {v for _, chart in series.stretches for v in (chart.low, chart.high)}
    top, bottom = (quantity(v, series.unit) if v in known else "" for v in reversed(reach))
    step = (_WIDTH - 2 * _EDGE) / max(1, len(points) - 1)

    def y(value: float) -> float:
        low, high = reach
        return round(_HEIGHT - _EDGE - (_HEIGHT - 2 * _EDGE) * (value - low) / (high - low), 1)

    dots, lines, control, calibrations = [], [], [], []
    first = 0
    for own, chart in series.stretches:
        xs = [round(_EDGE + step * (first + k), 1) for k in range(len(own))]
        unit = "" if series.unit == "1" else f" {series.unit}"
        for x, p in zip(xs, own, strict=True):
            words = (
                f"{number(p.value)}{unit}, {p.when:%Y-%m-%d %H:%M} UTC, {p.run}, calibration {p.calibration}"
            )
            dots.append({"x": x, "y": y(p.value), "tone": p.outcome, "words": words})
        lines.append(" ".join(f"{x},{y(p.value)}" for x, p in zip(xs, own, strict=True)))
        if chart.centre is not None and chart.low is not None and chart.high is not None:
            above, below = y(chart.high), y(chart.low)
            control.append(
                {
                    "x": xs[0] - 3,
                    "width": xs[-1] - xs[0] + 6,
                    "top": above,
                    "height": max(1.0, below - above),
                    "centre": y(chart.centre),
                }
            )
        if first:
            calibrations.append(
                {"x": round(xs[0] - step / 2, 1), "words": f"calibration {own[0].calibration}"}
            )
        first += len(own)
    limits = [y(v) for v in (series.low, series.high) if v is not None and reach[0] <= v <= reach[1]]
    return {
        "points": dots,
        "lines": lines,
        "limits": limits,
        "control": control,
        "calibrations": calibrations,
        "readings": _readings(series, step),
        "top": top,
        "bottom": bottom,
    }


def _readings(series: Series, step: float) -> str:
    """Return runs and values for the page's script; runs are numbered from 0."""
    values, last = [p.value for p in series.points], len(series.points) - 1
    edge = _EDGE / step
    low, high = _span(series)
    room = (high - low) * _EDGE / (_HEIGHT - 2 * _EDGE)
    unit = "" if series.unit == "1" else f" ({series.unit})"
    runs = {str(k): f"{p.when:%Y-%m-%d %H:%M} UTC, {p.run}"[:200] for k, p in enumerate(series.points)}
    return as_json(
        (_WIDTH, _HEIGHT),
        Readings(
            box=(0.0, 0.0, _WIDTH, _HEIGHT),
            zoom=False,
            x=Scale(label="", limits=(-edge, last + edge), names=dict(list(runs.items())[-MOST_POINTS:])),
            y=Scale(label=f"value{unit}", limits=(low - room, high + room)),
            series=[
                Curve(
                    colour="reference",
                    x=list(map(float, range(last + 1)))[-MOST_POINTS:],
                    y=values[-MOST_POINTS:],
                    mark=True,
                )
            ],
        ),
    )


def _span(series: Series) -> tuple[float, float]:
    """Return the value range of the picture: all measured values, and limits that are not far away."""
    values = [p.value for p in series.points]
    for _, chart in series.stretches:
        values += [v for v in (chart.low, chart.high) if v is not None]
    low, high = min(values), max(values)
    room = high - low or abs(high) or 1.0
    for limit in (series.low, series.high):
        if limit is not None and low - 2 * room <= limit <= high + 2 * room:
            low, high = min(low, limit), max(high, limit)
    return low, high if high > low else low + room
