"""Describes where and why a commissioning stopped, and the remedy: failed procedure, operator, full disk."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.core.errors import HilError
from hil.core.result_names import COMMISSIONING_TABLE
from hil.procedure.measurements import Verdict
from hil.procedure.run_result import KEEPING, Result
from hil.report.run_page import write_run_page


def stopped_at(result: Result, folder: Path) -> dict[str, Any]:
    """Return the entry of `hil commission --json` for a procedure that did not pass.

    Args:
        result: result of its run.
        folder: folder of the commissioning.
    """
    page = page_of(result)
    first = f"look at {page} and fix what it names; then "
    if page is None:
        first = "make room on the disk; then "
    elif result.verdict is Verdict.ABORTED:
        first = ""
    problem = result.error or next(iter(result.teardown_errors), None)
    return {
        "procedure": result.procedure,
        "verdict": result.verdict.value,
        "why": problem.message if problem is not None else missed(result.measurements),
        "held": result.facts["held"],
        "report": page,
        "do": first + go_on(folder),
    }


def stopped_before(name: str, error: HilError, folder: Path) -> dict[str, Any]:
    """Return the same entry if a person, a signal or the disk ended the commissioning between procedures."""
    first = f"{error.remedy}; then " if error.remedy else ""
    return {
        "procedure": name,
        "verdict": Verdict.ABORTED.value,
        "why": error.message,
        "held": None,
        "report": None,
        "do": first + go_on(folder),
    }


def go_on(folder: Path) -> str:
    """Return how to continue a commissioning."""
    if not (folder / COMMISSIONING_TABLE).is_file():
        kept = folder / COMMISSIONING_TABLE
        return f"start anew with another --out: {kept} is not there, so that it cannot be resumed"
    return (
        f"hil commission --resume --out {folder}, with the other options as before. "
        "What was found up to here is in the record and stays."
    )


def page_of(result: Result) -> str | None:
    """Write the page of a run; return its path, or None if it cannot be written."""
    if any(error.step == KEEPING for error in result.teardown_errors):
        return None
    try:
        return str(write_run_page(result.folder))
    except HilError:
        return None


def missed(measurements: Sequence[Mapping[str, Any]]) -> str:
    """Return failed measurements as text: first values beyond their limits, then unmeasured ones."""
    failed = [row for row in measurements if row["outcome"] == "FAIL"]
    beyond, absent = (
        [str(r["name"]) for r in failed if (r["value"] is None) == gone] for gone in (False, True)
    )
    parts = (("beyond their limits", beyond), ("not measured", absent))
    return "; ".join(f"{what}: {', '.join(names)}" for what, names in parts if names)
