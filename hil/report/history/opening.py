"""The page of one of the results."""

from __future__ import annotations

from pathlib import Path

from hil.core.errors import DataError
from hil.core.result_files import ACCEPTANCE_PAGE, CAMPAIGN_PAGE, COMMISSIONING_PAGE, FAULTS_PAGE, REPORT
from hil.report.history.index import ACCEPTANCE, CAMPAIGN, COMMISSIONING, FAULTS, RUN, Kept
from hil.report.run_page import write_run_page

PAGES = {
    RUN: REPORT,
    CAMPAIGN: CAMPAIGN_PAGE,
    COMMISSIONING: COMMISSIONING_PAGE,
    ACCEPTANCE: ACCEPTANCE_PAGE,
    FAULTS: FAULTS_PAGE,
}
"""File name of the page by the kind of a result; other kinds have none."""


def page_of(kept: Kept) -> Path:
    """Where its page is; that of a run is written if it is missing.

    Raises:
        DataError: it has none.
    """
    page = kept.folder / PAGES.get(kept.kind, "")
    if page.is_file():
        return page
    if kept.kind == RUN:
        return write_run_page(kept.folder)
    raise DataError(str(kept.folder), f"has no page ({kept.why})")
