"""Summarises a run in one sentence, and groups its measurements by device."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hil.core.rounding import digits_apart
from hil.report.page_formats import as_people_read, limit_words, quantity

_WHEEL = re.compile(r"^(?:steer|drive|wheel)_(FL|BL|BR|FR)$")
_CASES = {"x_line": "up the wall (X line)", "y_line": "across the wall (Y line)", "scan": "scan"}
_WHOLE = "the run as a whole"
_FEW = 8
_NAMED = 3


def sentence(tree: Mapping[str, Any]) -> str:
    """Return a summary: the errors that decide the verdict, else the procedure's headline and its limits.

    These are the one that ended the run early, or those of its end, such as a robot that is not held.
    Without a headline the values are listed, those nearest to their limits first.

    Args:
        tree: content of `result.json`.
    """
    own = str(tree.get("headline") or "")
    if tree["error"]:
        where = "after" if tree["error"].get("finished") else "in"
        return f"The run ended early, {where} “{tree['error']['step']}”: {tree['error']['message']}"
    if tree["teardown_errors"]:
        errors = [f"in “{error['step']}”: {error['message']}" for error in tree["teardown_errors"]]
        return f"The run did not end well, {'; '.join(errors)} {own}".strip()
    rows = tree["measurements"]
    if not rows:
        return f"{own} Nothing was measured.".strip()
    later = _left_out_after_a_failure(rows)
    sentences = [own, _limits([r for r in rows if r not in later], rows, also=bool(own))]
    if later:
        sentences.append(f"What comes after that was not measured: {_listed([_name(r) for r in later])}.")
    if unmeasured := [r for r in rows if not _has_limits(r) and r["outcome"] == "FAIL" and r not in later]:
        sentences.append(f"Failed without a value: {_named(unmeasured)}.")
    return " ".join(filter(None, sentences))


def _has_limits(row: Mapping[str, Any]) -> bool:
    return row["low"] is not None or row["high"] is not None


def _is_number(row: Mapping[str, Any]) -> bool:
    return row["value"] is not None and math.isfinite(row["value"])


def was_set(row: Mapping[str, Any]) -> bool:
    """Whether the procedure set the measurement; a value that JSON cannot hold leaves only its `step`."""
    return row["value"] is not None or bool(row.get("step"))


def _left_out_after_a_failure(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return trailing measurements that were never set, after one whose value failed."""
    count = next((k for k, row in enumerate(reversed(rows)) if was_set(row)), len(rows))
    before, later = rows[: len(rows) - count], rows[len(rows) - count :]
    failed = any(r["outcome"] == "FAIL" and _is_number(r) for r in before)
    return [r for r in later if r["outcome"] == "FAIL"] if failed else []


def _limits(rows: Sequence[Mapping[str, Any]], every: Sequence[Mapping[str, Any]], *, also: bool) -> str:
    """Return sentences about the limits of `rows`, as a share of those of `every` row."""
    judged = [r for r in rows if _has_limits(r) and r["outcome"] != "NOT MEASURED"]
    failed = [r for r in judged if r["outcome"] == "FAIL"]
    if failed:
        counted = [r for r in every if _has_limits(r) and r["outcome"] != "NOT MEASURED"]
        return f"{_of(failed, counted, 'failed')}: {_named(failed)}."
    near = [r for r in judged if r["outcome"] == "MARGINAL"]
    if not judged:
        return ""
    if near:
        return f"{_of(near, judged, 'held by a small margin')}: {_named(near)}."
    whole = "Its one limit held" if len(judged) == 1 else f"All {len(judged)} limits held"
    if also:
        return f"{whole}."
    if len(judged) <= _NAMED:
        return f"{whole}: {_named(judged)}."
    tightest = sorted(judged, key=_room)[:_NAMED]
    return f"{whole}; nearest to their limits: {_named(tightest)}."


def _of(some: Sequence[object], every: Sequence[object], did: str) -> str:
    if len(every) == 1:
        return f"Its one limit {did}"
    return f"{len(some)} of {len(every)} limits {did}"


def _room(row: Mapping[str, Any]) -> tuple[bool, float]:
    """Sort key of kept limits: distance to the limit; counts and yes/no, often at their limit, last."""
    low, high, value = row["low"], row["high"], row["value"]
    margin = min(abs(value - limit) for limit in (low, high) if limit is not None)
    width = high - low if low is not None and high is not None else abs(low if high is None else high)
    return row["unit"] == "1", margin / width if width else margin


def _named(rows: Sequence[Mapping[str, Any]]) -> str:
    return _listed([_value_and_limit(r) for r in rows])


def _listed(words: Sequence[str]) -> str:
    return "; ".join(words[:_NAMED]) + (f"; and {len(words) - _NAMED} more" if len(words) > _NAMED else "")


def _name(row: Mapping[str, Any]) -> str:
    name = str(row["name"])
    return name if "." in name else name.replace("_", " ")


def missing_words(row: Mapping[str, Any]) -> str:
    """Return why a measurement has no value."""
    return "is no finite number" if was_set(row) else "was never measured"


def _value_and_limit(row: Mapping[str, Any]) -> str:
    """Return `end error 2.3 mm, at most 10 mm`: in mm and deg, with digits that tell value from limit."""
    name, own = _name(row), as_people_read(row)
    value = own["value"]
    if not _is_number(row):
        return ", ".join(filter(None, (f"{name} {missing_words(row)}", limit_words(own))))
    digits = digits_apart(value, (own["low"], own["high"]), least=3)
    shown = max(digits, 4)
    return f"{name} {quantity(float(f'{value:.{digits}g}'), own['unit'], shown)}, {limit_words(own, shown)}"


def grouped(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Group rows of measurements by the part of their names before the first dot.

    Returns:
        `title`, `rows`, their `count`, `counts` by outcome, and `bad`, the outcomes other than pass, of each
        group; few rows, or rows of one kind, form one group without a title.
    """
    titles = [_title(str(row["name"])) for row in rows]
    together = len(rows) <= _FEW or len(set(titles)) < 2
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for title, row in zip(titles, rows, strict=True):
        groups.setdefault("" if together else title, []).append(row)
    return [_group(title, own) for title, own in groups.items()]


def _group(title: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    counts = Counter(str(row["outcome"]) for row in rows if "outcome" in row)
    return {"title": title, "rows": rows, "count": len(rows), "counts": counts, "bad": set(counts) - {"PASS"}}


def _title(name: str) -> str:
    first, dot, _ = name.partition(".")
    if not dot and not (_WHEEL.match(first)):
        return _WHOLE
    wheel = _WHEEL.match(first)
    return f"wheel {wheel[1]}" if wheel else _CASES.get(first, first.replace("_", " "))
