"""Finds the page of a result."""

from pathlib import Path

from hil.core.errors import DataError
from hil.core.result_names import ACCEPTANCE_PAGE, CAMPAIGN_PAGE, COMMISSIONING_PAGE, FAULTS_PAGE, REPORT
from hil.report.history.index import ACCEPTANCE, CAMPAIGN, COMMISSIONING, FAULTS, RUN, Kept
from hil.report.run_page import write_run_page

PAGES = {
    RUN: REPORT,
    CAMPAIGN: CAMPAIGN_PAGE,
    COMMISSIONING: COMMISSIONING_PAGE,
    ACCEPTANCE: ACCEPTANCE_PAGE,
    FAULTS: FAULTS_PAGE,
}
"""File name of the page by kind of result; other kinds have no page."""


def page_of(kept: Kept) -> Path:
    """Return the path of the page of a result; the page of a run is written if it is missing.

    Raises:
        DataError: the result has no page.
    """
    page = kept.folder / PAGES.get(kept.kind, "")
    if page.is_file():
        return page
    if kept.kind == RUN:
        return write_run_page(kept.folder)
    raise DataError(str(kept.folder), f"has no page ({kept.why})")
