"""The page of a fault campaign: verdict, failures, bounds and the worst measured, matrix; and its JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.core.result_files import FAULTS_PAGE, FAULTS_TABLE
from hil.report.pages import environment
from hil.support.atomic_files import put_whole, refused


def write_faults(folder: Path, summary: Mapping[str, Any]) -> Path:
    """Write `faults.html` and `faults.json`; returns the path of the page.

    Args:
        folder: of the campaign; must exist.
        summary: as `hil.procedure.faults.summary` returns it, with `began`, ISO 8601.

    Raises:
        DataError: they cannot be written.
    """
    page = environment().get_template("faults.html").render(summary=summary)
    data = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    for name, text in ((FAULTS_PAGE, page), (FAULTS_TABLE, data)):
        try:
            put_whole(folder / name, text.encode("utf-8", "backslashreplace"))
        except OSError as error:
            raise refused(folder / name, error) from None
    return folder / FAULTS_PAGE
