"""Names of the files that make a folder a result, and the verdicts that count as passed.

All code that writes, reads, shows or deletes such a folder takes them from here.
"""

RESULT, JOURNAL, REPORT, JUNIT = "result.json", "journal.jsonl", "report.html", "junit.xml"
"""Files of a run."""
RESULT_SCHEMA = 1
"""Number of the format of `result.json`."""

PLAN, CAMPAIGN_TABLE, CAMPAIGN_CSV, CAMPAIGN_PAGE = (
    "plan.json",
    "campaign.json",
    "campaign.csv",
    "campaign.html",
)
RUNS, ROWS = "runs", "rows"
"""Folders of a campaign, beside its files: its runs, and its rows."""

COMMISSIONING_TABLE, COMMISSIONING_PAGE = "commission.json", "commission.html"
"""Files of a commissioning."""

ACCEPTANCE_TABLE, ACCEPTANCE_PAGE = "accept.json", "accept.html"
"""Files of an acceptance."""

WRONG_VALUES_TABLE = "wrong_values.md"
FAULTS_TABLE, FAULTS_PAGE, FAULTS_MATRIX = "faults.json", "faults.html", "reliability.md"
FAULTS_CELLS, FAULTS_CELLS_BEFORE = "cells.jsonl", "cells.before.jsonl"
"""Files of a fault campaign: table and pages, verdicts as they come, verdicts of the one before."""

SESSION, LIVE_RECORDING, SESSION_PAGE = "session.json", "recording.mcap", "session.html"
"""Files of a live session."""

COMPARISON, TRENDS = "compare.html", "trends.html"
"""Pages over several of them."""

PASSED = ("PASS", "MARGINAL")
"""Verdicts of what kept its limits, so that its findings may be used."""

LOST = "LOST"
"""Word in place of a verdict: a run of a campaign without a result, which says nothing about the robot."""


_BY_ITSELF, _ASKED = ("duration", "trajectory"), ("SIG", "key ", "button ")


def end_of_session(ended: str, held: str) -> str:
    """Verdict of a live session in a word: `DONE`, `ENDED` by a signal, `ERROR`, or `NOT HELD`.

    Args:
        ended: reason of its end.
        held: state in which it left the robot.
    """
    if held == "NOT HELD":
        return held
    if ended in _BY_ITSELF or ended.startswith(_ASKED[1:]):
        return "DONE"
    return "ENDED" if ended.startswith(_ASKED) else "ERROR"
