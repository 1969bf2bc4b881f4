"""Shared parts of all pages: templates, the script for figures, formats of numbers, times and verdicts."""

import base64
import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from hil.core.cross_check import bound_text
from hil.core.event_rows import injected_line
from hil.core.rounding import digits_apart
from hil.report.page_figures import theme

_PLAIN = 1e6
_READ = {
    "m": ("mm", 1e3, 0.5),
    "m/s": ("mm/s", 1e3, 0.5),
    "s": ("ms", 1e3, 0.5),
    "rad": ("deg", math.degrees(1.0), math.inf),
    "rad/s": ("deg/s", math.degrees(1.0), math.inf),
}
"""Displayed unit, factor to it, and the size from which a value keeps its original unit."""


@cache
def environment() -> Environment:
    """Return the templates of the pages. Pages run only `script`: their security policy contains its hash."""
    env = Environment(loader=PackageLoader("hil.report", "templates"), autoescape=True, trim_blocks=True)
    env.filters["number"] = number
    env.filters["duration"] = duration
    env.filters["injected"] = injected_line
    env.filters["bound"] = bound_text
    script = files("hil.report").joinpath("templates/figure.js").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    env.globals |= {
        "degrees": math.degrees,
        "script": Markup(script),
        "script_hash": f"sha256-{digest}",
        "figure_theme": {name: Markup(colours) for name, colours in theme().items()},
    }
    return env


def number(value: object, digits: int = 4) -> str:
    """Format a number with four significant digits by default; a dash for none."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "–"
        return f"{value:.0f}" if digits <= 4 and 1e3 <= abs(value) < _PLAIN else f"{value:.{digits}g}"
    return str(value)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Format a number with its unit: `1.5 mm`; without unit for a ratio."""
    return number(value, digits) if unit in ("1", "") or value is None else f"{number(value, digits)} {unit}"


def as_people_read(row: Mapping[str, Any]) -> dict[str, Any]:
    """Convert value and limits of a measurement to mm, ms and deg, if they are small in m, s and rad.

    Args:
        row: row with `unit`, `value`, `low` and `high`.
    """
    unit, factor, below = _READ.get(row["unit"], (row["unit"], 1.0, math.inf))
    own = {key: row[key] for key in ("value", "low", "high")}
    if any(v is not None and abs(v) >= below for v in own.values()):
        return {"unit": row["unit"], **own}
    return {"unit": unit, **{k: None if v is None else factor * v for k, v in own.items()}}


def columns_of_words(rows: Sequence[Sequence[str]]) -> set[int]:
    """Return the columns, from 1, whose cells are text rather than numbers."""
    return {
        k for row in rows for k, cell in enumerate(row, start=1) if len(re.findall(r"[^\W\d_]{3,}", cell)) > 1
    }


def duration(seconds: float | None) -> str:
    """Format a duration in seconds for the reader."""
    if seconds is None:
        return "–"
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{int(seconds // 60)} min {int(seconds % 60)} s"


def outcome_words(row: Mapping[str, Any]) -> dict[str, str]:
    """Return name and colour class of an outcome; a value without limits is only reported."""
    if row["outcome"] == "PASS" and not row.get("limited", True):
        return {"word": "reported", "tone": "reported"}
    return {"word": row["outcome"], "tone": row["outcome"]}


def limit_words(row: Mapping[str, Any], digits: int = 4) -> str:
    """Return the limits of a measurement as text: `at most 8 mm`; empty for none."""
    low, high, unit = row["low"], row["high"], row["unit"]
    if low is not None and high is not None:
        return f"{number(low, digits)} to {quantity(high, unit, digits)}"
    if high is not None:
        return f"at most {quantity(high, unit, digits)}"
    return f"at least {quantity(low, unit, digits)}" if low is not None else ""


def digits_of(row: Mapping[str, Any]) -> int:
    """Return the number of digits needed to distinguish a value from a limit that it does not meet."""
    value = row["value"]
    if value is None or not math.isfinite(value):
        return 4
    return digits_apart(value, (row["low"], row["high"]))
