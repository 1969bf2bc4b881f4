"""The figures of docs/adhesion.md are those that its benchmark finds."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_the_energy_per_metre_is_what_the_benchmark_finds():
    page = (ROOT / "docs" / "adhesion.md").read_text(encoding="utf-8")
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "energy_per_metre.py"))
    missing = [row for row in benchmark["rows"]() if row not in page]
    assert missing == []
