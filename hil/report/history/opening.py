"""Finds the page of a result."""

from pathlib import Path

from hil.core.errors import DataError
from hil.core.result_names import (
    ACCEPTANCE_PAGE,
    CAMPAIGN_PAGE,
    COMMISSIONING_PAGE,
    FAULTS_PAGE,
    REPORT,
    SESSION_PAGE,
)
from hil.report.history.index import ACCEPTANCE, CAMPAIGN, COMMISSIONING, FAULTS, LIVE, RUN, Kept
from hil.report.run_page import write_run_page
from hil.report.session_page import write_session_page
from hil.support.progress import Report, silent

PAGES = {
    RUN: REPORT,
    CAMPAIGN: CAMPAIGN_PAGE,
    COMMISSIONING: COMMISSIONING_PAGE,
    ACCEPTANCE: ACCEPTANCE_PAGE,
    FAULTS: FAULTS_PAGE,
    LIVE: SESSION_PAGE,
}
"""File name of the page by kind of result; other kinds have no page."""


def page_of(kept: Kept, report: Report = silent) -> Path:
    """Return the path of the page of a result; that of a run or a live session is written if it is missing.

    The page of a session that has not ended is written anew each time.

    Args:
        kept: the result.
        report: progress of writing the page.

    Raises:
        DataError: the result has no page.
    """
    page = kept.folder / PAGES.get(kept.kind, "")
    if page.is_file() and (kept.kind != LIVE or kept.verdict):
        return page
    if kept.kind == RUN:
        return write_run_page(kept.folder)
    if kept.kind == LIVE:
        return write_session_page(kept.folder, report)
    raise DataError(str(kept.folder), f"has no page ({kept.why})")
