"""The page of an acceptance: verdict, devices, every check, and lines to sign; and its JSON."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.core.result_names import ACCEPTANCE_PAGE, ACCEPTANCE_TABLE
from hil.report.page_formats import environment
from hil.support.atomic_files import staged


def write_acceptance(folder: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Write `accept.json`, and `accept.html` which names its SHA-256.

    Args:
        folder: created if it does not exist.
        summary: result of `hil.commission.acceptance.accept`.

    Returns:
        The summary with the paths `page`, `data` and `folder` of the written files.

    Raises:
        DataError: a file cannot be written; then neither file is left.
    """
    text = (json.dumps(summary, indent=2, allow_nan=False) + "\n").encode()
    page = (
        environment()
        .get_template("acceptance.html")
        .render(
            summary=summary,
            rows=[_counted(stage) for stage in summary["stages"]],
            digest=hashlib.sha256(text).hexdigest(),
            data=ACCEPTANCE_TABLE,
            sentence=_sentence(summary["stages"]),
        )
    )
    with staged(folder) as parts:
        (parts / ACCEPTANCE_TABLE).write_bytes(text)
        (parts / ACCEPTANCE_PAGE).write_text(page, encoding="utf-8", errors="backslashreplace")
    return {
        **summary,
        "folder": str(folder),
        "page": str(folder / ACCEPTANCE_PAGE),
        "data": str(folder / ACCEPTANCE_TABLE),
    }


def _sentence(stages: Sequence[Mapping[str, Any]]) -> str:
    """Return a summary: number of checks, and of failures and warnings with their devices."""
    findings = [finding for stage in stages for finding in stage["findings"]]
    wrong = []
    for level, word in (("failure", "failed"), ("warning", "with a warning")):
        devices = [finding["device"] for finding in findings if finding["level"] == level]
        if devices:
            wrong.append(f"{len(devices)} {word} ({', '.join(dict.fromkeys(devices))})")
    if not wrong:
        return f"All {len(findings)} checks passed."
    return f"Of {len(findings)} checks, {' and '.join(wrong)}; see below what to do."


def _counted(stage: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stage with the number of its checks by outcome."""
    levels = [finding["level"] for finding in stage["findings"]]
    words = {"ok": "right", "warning": "warnings", "failure": "failed"}
    counted = ", ".join(f"{levels.count(k)} {word}" for k, word in words.items() if k in levels)
    return {**stage, "counted": counted}
