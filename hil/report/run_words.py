"""What happened in a run, in a sentence; and its measurements in groups, by the device that they speak of."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hil.report.pages import as_people_read, limit_words, quantity

_WHEEL = re.compile(r"^(?:steer|drive|wheel)_(FL|BL|BR|FR)$")
_CASES = {"x_line": "up the wall (X line)", "y_line": "across the wall (Y line)", "scan": "scan"}
_WHOLE = "the run as a whole"
_FEW = 8
_NAMED = 3


def sentence(tree: Mapping[str, Any]) -> str:
    """What happened: what ended the run early, else what its procedure says, and how its limits did.

    A procedure that says nothing of its own has its values told, those nearest to their limits first.

    Args:
        tree: of `result.json`.
    """
    if tree["error"]:
        where = "after" if tree["error"].get("finished") else "in"
        return f"The run ended early, {where} “{tree['error']['step']}”: {tree['error']['message']}"
    own = str(tree.get("headline") or "")
    return f"{own} {_limits(tree['measurements'], told=bool(own))}".strip()


def _limits(rows: Sequence[Mapping[str, Any]], *, told: bool) -> str:
    judged = [r for r in rows if r["low"] is not None or r["high"] is not None]
    judged = [r for r in judged if r["value"] is not None or r["outcome"] == "FAIL"]
    failed = [r for r in judged if r["outcome"] == "FAIL"]
    measured = [r for r in failed if r["value"] is not None]
    if measured and len(measured) < len(failed):
        missing = len(failed) - len(measured)
        return (
            f"{_of(measured, judged, 'failed')}: {_named(measured)}. "
            f"What comes after that was not measured: {missing} more."
        )
    near = [r for r in judged if r["outcome"] == "MARGINAL"]
    if failed:
        return f"{_of(failed, judged, 'failed')}: {_named(failed)}."
    if not judged:
        return ""
    if near:
        return f"{_of(near, judged, 'held by little')}: {_named(near)}."
    whole = "Its one limit held" if len(judged) == 1 else f"All {len(judged)} limits held"
    if told:
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
    """Orders kept limits by how near their values are; counts and answers, which often meet theirs, last."""
    low, high, value = row["low"], row["high"], row["value"]
    margin = min(abs(value - limit) for limit in (low, high) if limit is not None)
    width = high - low if low is not None and high is not None else abs(low if high is None else high)
    return row["unit"] == "1", margin / width if width else margin


def _named(rows: Sequence[Mapping[str, Any]]) -> str:
    said = [_value_and_limit(r) for r in rows[:_NAMED]]
    return "; ".join(said) + (f"; and {len(rows) - _NAMED} more" if len(rows) > _NAMED else "")


def _value_and_limit(row: Mapping[str, Any]) -> str:
    """`end error 2.3 mm, at most 10 mm`: in mm and deg, with digits enough to tell it from its limits."""
    name = str(row["name"])
    name = name if "." in name else name.replace("_", " ")
    own = as_people_read(row)
    limits = [own[k] for k in ("low", "high") if own[k] is not None]
    value = own["value"]
    if value is None:
        return f"{name} was never measured, {limit_words(own)}"
    digits = next(
        (
            n
            for n in (3, 4, 6, 8)
            if all(value == v or float(f"{value:.{n}g}") != float(f"{v:.{n}g}") for v in limits)
        ),
        12,
    )
    return f"{name} {quantity(float(f'{value:.{digits}g}'), own['unit'], max(digits, 4))}, {limit_words(own)}"


def grouped(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of measurements in groups, by what stands before the first dot of their names.

    Returns:
        `title`, `rows`, their `count`, `counts` by outcome, and `bad`, the outcomes that are no pass, of each
        group; few rows, or rows of one kind, are one group without a title.
    """
    titles = [_title(str(row["name"])) for row in rows]
    together = len(rows) <= _FEW or len(set(titles)) < 2
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for title, row in zip(titles, rows, strict=True):
        groups.setdefault("" if together else title, []).append(row)
    return [_group(title, own) for title, own in groups.items()]


def _group(title: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    counts = Counter(str(row["outcome"]) for row in rows if "outcome" in row)
    return {
        "title": title, "rows": rows, "count": len(rows), "counts": counts, "bad": set(counts) - {"PASS"},
    }  # fmt: skip


def _title(name: str) -> str:
    first, dot, _ = name.partition(".")
    if not dot and not (_WHEEL.match(first)):
        return _WHOLE
    wheel = _WHEEL.match(first)
    return f"wheel {wheel[1]}" if wheel else _CASES.get(first, first.replace("_", " "))
