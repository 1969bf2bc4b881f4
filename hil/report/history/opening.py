"""The page of one of the results."""

from __future__ import annotations

from pathlib import Path

from hil.report.history.found import ACCEPTANCE, CAMPAIGN, COMMISSIONING, RUN, Kept
from hil.report.run_page import PAGE, write_run_page
from hil.vocabulary.errors import DataError

PAGES = {
    RUN: PAGE,
    CAMPAIGN: "campaign.html",
    COMMISSIONING: "commission.html",
    ACCEPTANCE: "accept.html",
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
