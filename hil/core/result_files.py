"""Names of the files that make a folder a result, and the verdicts that count as passed.

All code that writes, reads, shows or deletes such a folder takes them from here.
"""

from __future__ import annotations

RESULT, JOURNAL, REPORT, JUNIT = "result.json", "journal.jsonl", "report.html", "junit.xml"
"""Of a run."""
RESULT_SCHEMA = 1
"""Of `result.json`."""

PLAN, CAMPAIGN_TABLE, CAMPAIGN_CSV, CAMPAIGN_PAGE = (
    "plan.json",
    "campaign.json",
    "campaign.csv",
    "campaign.html",
)
RUNS, ROWS = "runs", "rows"
"""Of a campaign: files, and folders of its runs and of their rows."""

COMMISSIONING_TABLE, COMMISSIONING_PAGE = "commission.json", "commission.html"
"""Of a commissioning."""

ACCEPTANCE_TABLE, ACCEPTANCE_PAGE = "accept.json", "accept.html"
"""Of an acceptance."""

FAULTS_TABLE, FAULTS_PAGE, FAULTS_MATRIX = "faults.json", "faults.html", "reliability.md"
FAULTS_CELLS, FAULTS_CELLS_BEFORE = "cells.jsonl", "cells.before.jsonl"
"""Of a fault campaign: its table and pages, its verdicts as they come, and those of one before it."""

COMPARISON, TRENDS = "compare.html", "trends.html"
"""Pages over several of them."""

PASSED = ("PASS", "MARGINAL")
"""Verdicts of what kept its limits, so that its findings may be used."""

LOST = "LOST"
"""In place of a verdict: a run of a campaign that left no result, which says nothing about the robot."""
