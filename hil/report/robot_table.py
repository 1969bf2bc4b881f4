"""Rows about the known parameters of a robot: part, values, uncertainty, procedure, date, validity."""

import math
from collections.abc import Iterator
from datetime import date
from typing import Any

from hil.config.robot_record import PARTS, Confirmation, Figure, Part, RecordFile

_SHOWN = {
    "rad": ("deg", math.degrees(1.0)),
    "m": ("mm", 1e3),
    "s": ("ms", 1e3),
    "m/m": ("mm/m", 1e3),
    "rad/m": ("deg/m", math.degrees(1.0)),
}


def part_rows(file: RecordFile, today: date) -> list[dict[str, Any]]:
    """Return one row per possible part, as JSON values.

    Args:
        file: version of a record.
        today: date for the check of validity.

    Returns:
        `part`, `title`, `known`, `by`, `verdict`, `since`, `until`, `out_of_date`, `surface`, `figures`
        (`name`, `value`, `sigma`, `unit`), `measured_by`.
    """
    return [_row(name, file.parts.get(name), today) for name in PARTS]


def _row(name: str, part: Part | None, today: date) -> dict[str, Any]:
    kind = PARTS[name]
    row: dict[str, Any] = {
        "part": name,
        "title": kind.title,
        "known": part is not None,
        "measured_by": kind.measured_by,
    }
    if part is None:
        return row
    return row | {
        "by": part.procedure,
        "verdict": part.verdict,
        "bench": part.bench,
        "since": part.measured,
        "until": part.until,
        "out_of_date": part.over(today),
        "surface": part.surface,
        "values": dict(part.values),
        "figures": list(_figures(part)),
    }


def _figures(part: Part) -> Iterator[dict[str, Any]]:
    for name, figure in part.figures.items():
        yield {
            "name": name,
            "value": figure.value,
            "sigma": figure.sigma,
            "unit": figure.unit,
            "words": in_words(figure),
        }


def in_words(figure: Figure) -> str:
    """Format a figure with its standard uncertainty in the usual unit: `100.312 ± 0.084 %`."""
    unit, factor = _SHOWN.get(figure.unit, ("" if figure.unit == "1" else figure.unit, 1.0))
    value = factor * figure.value
    if figure.sigma is None or figure.sigma <= 0.0:
        return f"{value:.4g} {unit}".strip()
    sigma = factor * figure.sigma
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{min(digits, 9)}f} ± {sigma:.{min(digits, 9)}f} {unit}".strip()


def differences(old: RecordFile, new: RecordFile) -> list[dict[str, Any]]:
    """Compare two versions of a record.

    Returns:
        Rows of `part`, `name` (of a value or figure; empty for a whole part), `old`, `new`, and
        `sigmas`: the change divided by its standard uncertainty, if both are known.
    """
    rows: list[dict[str, Any]] = []
    for name in PARTS:
        before, after = old.parts.get(name), new.parts.get(name)
        if before is None or after is None:
            if before is not after:
                rows.append(
                    {"part": name, "name": "", "old": _known(before), "new": _known(after), "sigmas": None}
                )
            continue
        for key in dict.fromkeys((*before.values, *after.values)):
            a, b = before.values.get(key), after.values.get(key)
            if a != b:
                rows.append({"part": name, "name": key, "old": a, "new": b, "sigmas": None})
        for key in dict.fromkeys((*before.figures, *after.figures)):
            rows += _change(name, key, before.figures.get(key), after.figures.get(key))
    for key in dict.fromkeys((*old.confirmed, *new.confirmed)):
        then, now = _said(old.confirmed.get(key)), _said(new.confirmed.get(key))
        if then != now:
            rows.append({"part": "confirmed", "name": key, "old": then, "new": now, "sigmas": None})
    return rows


def _said(one: Confirmation | None) -> str:
    return "by nothing" if one is None else f"{one.value} by {one.by} {one.bound}".strip()


def _known(part: Part | None) -> str:
    return "not known" if part is None else f"{part.procedure} of {part.measured}"


def _change(part: str, key: str, before: Figure | None, after: Figure | None) -> list[dict[str, Any]]:
    if before == after:
        return []
    sigmas = None
    if before is not None and after is not None and (before.sigma or after.sigma):
        spread = math.hypot(before.sigma or 0.0, after.sigma or 0.0)
        sigmas = (after.value - before.value) / spread
    words = ["not known" if figure is None else in_words(figure) for figure in (before, after)]
    return [{"part": part, "name": key, "old": words[0], "new": words[1], "sigmas": sigmas}]
