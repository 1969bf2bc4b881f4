"""What a fault campaign leaves: a page, found among the results, and opened."""

import pytest

from hil.fault_matrix import CellVerdict, cells_of, summary
from hil.fault_matrix.matrix_table import write_faults
from hil.report.history.index import find_results
from hil.report.history.opening import page_of
from hil.report.history.query import LAST, named

CELLS = cells_of({"servos": {"off": (), "jump": ()}}, seeds=(0,), plants=("own",), moments=("motion",))


@pytest.fixture
def left(tmp_path):
    """A folder of results with a campaign in which one of two cells failed."""
    verdicts = [
        CellVerdict(cell, why, "went on", True, "HELD")
        for cell, why in zip(CELLS, ((), ("it <fell>",)), strict=True)
    ]
    reported = summary(verdicts, bench="emulated", command="hil faults --seeds 0:1", planned=len(verdicts))
    (tmp_path / "faults").mkdir()
    (tmp_path / "faults" / "cells.jsonl").write_text("{}\n", encoding="utf-8")
    write_faults(tmp_path / "faults", {**reported, "began": "2026-01-31T12:00:00+00:00"})
    return tmp_path


def test_it_is_found_with_its_verdict_and_opened_by_its_name(left):
    (kept,) = find_results(left)
    assert (kept.kind, kept.bench, kept.verdict, kept.where) == ("faults", "emulated", "FAIL", "emulated")
    assert "2 runs with faults, 1 failed" in kept.why
    assert named([kept], LAST) is kept
    page = page_of(kept).read_text(encoding="utf-8")
    assert "it &lt;fell&gt;" in page
    assert "hil faults --seeds 0:1" in page


def test_one_that_has_not_come_to_its_end_is_found_as_that(left):
    for name in ("faults.json", "faults.html"):
        (left / "faults" / name).unlink()
    (kept,) = find_results(left)
    assert kept.kind == "unfinished"
    assert "--resume" in kept.why


@pytest.mark.parametrize("text", ["{", "[]", '{"verdict": 3}', '{"verdict": "PASS", "cells": 2}'])
def test_a_table_of_something_else_is_shown_as_foreign(left, text):
    (left / "faults" / "faults.json").write_text(text, encoding="utf-8")
    (kept,) = find_results(left)
    assert kept.kind == "foreign"
