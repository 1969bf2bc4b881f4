"""Puts the results of one run of the campaign of wrong values into docs/wrong-values.md.

    hil faults --configuration --plants own --out out/wrong_values
    python docs/make_wrong_values.py out/wrong_values/wrong_values.md

Everything from the page's line with the counts on is replaced by that of the run.
"""

import re
import sys
from pathlib import Path

PAGE = Path(__file__).with_name("wrong-values.md")
_COUNTS = re.compile(r"^\d+ cases\b.*", re.MULTILINE | re.DOTALL)


def with_results(page: str, run: str) -> str:
    """The page with the counts and the table of a run; raises `ValueError` if one of them has none."""
    found = _COUNTS.search(run)
    before = _COUNTS.search(page)
    if found is None or before is None:
        raise ValueError("no line with the number of cases")
    return page[: before.start()] + found.group()


def main() -> None:
    """Write the page."""
    (run,) = map(Path, sys.argv[1:])
    PAGE.write_text(with_results(PAGE.read_text(), run.read_text()))


if __name__ == "__main__":
    main()
