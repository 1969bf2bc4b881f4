"""Writes the results of the campaign of wrong values: JSON, and a table for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.procedure.wrong_values.cases import shown
from hil.procedure.wrong_values.judge import Verdict


def summary(verdicts: Sequence[Verdict], table: Path) -> dict[str, Any]:
    """Return the JSON of the command."""
    counts = Counter(verdict.outcome for verdict in verdicts)
    return {
        "cases": len(verdicts),
        **{name: counts[name] for name in ("right", "misnamed", "harmless", "unconfirmed")},
        "silent": [
            {"key": v.case.key, "file": v.case.said, "true": v.case.true, "what": v.what}
            for v in verdicts
            if v.outcome == "silent"
        ],
        "table": str(table),
    }


def write_pages(verdicts: Sequence[Verdict], path: Path) -> None:
    """Write the table of all cases, Markdown."""
    rows = [
        "| key | file | true | bench | verdict | named by | what was said or seen |",
        "|---|---|---|---|---|---|---|",
    ]
    for v in verdicts:
        where = ", ".join(filter(None, (v.case.plant, v.case.bench)))
        what = v.what.replace("|", "\\|").replace("\n", " ")
        rows.append(
            f"| `{v.case.key}` | {shown(v.case.said)} | {shown(v.case.true)} | {where} | {v.outcome} "
            f"| {', '.join(v.named_by)} | {what} |"
        )
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
