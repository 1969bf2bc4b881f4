"""The page of one of the results."""

from __future__ import annotations

from pathlib import Path

from hil.report.history.found import CAMPAIGN, COMMISSIONING, RUN, Kept
from hil.report.run_page import PAGE, write_run_page
from hil.vocabulary.errors import DataError

_NAMES = {RUN: PAGE, CAMPAIGN: "campaign.html", COMMISSIONING: "commission.html"}


def page_of(kept: Kept) -> Path:
    """Where its page is; that of a run is written if it is missing.

    Raises:
        DataError: it has none.
    """
    page = kept.folder / _NAMES.get(kept.kind, "")
    if page.is_file():
        return page
    if kept.kind == RUN:
        return write_run_page(kept.folder)
    raise DataError(str(kept.folder), f"has no page ({kept.why})")
