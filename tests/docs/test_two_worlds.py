"""docs/two-worlds.md is made from the figures beside it, and from nothing else."""

import importlib
import json
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def two_worlds(monkeypatch):
    """Modules of the command that makes the page."""
    monkeypatch.syspath_prepend(str(DOCS))
    yield lambda name: importlib.import_module(f"two_worlds.{name}")
    for name in [m for m in sys.modules if m.split(".")[0] == "two_worlds"]:
        del sys.modules[name]


def test_the_page_is_what_its_command_makes_of_the_figures(two_worlds, tmp_path, monkeypatch):
    page, results = two_worlds("page"), two_worlds("results")
    monkeypatch.setattr(page, "PAGE", tmp_path / "page.md")
    page.write(*(results.known(name) for name in ("oracles", "procedures", "wall", "calibration")))
    assert (tmp_path / "page.md").read_text() == (DOCS / "two-worlds.md").read_text()
    assert "<!--" not in (tmp_path / "page.md").read_text()


def rows_of(name):
    """Figures beside the page."""
    lines = (DOCS / "two_worlds" / "figures" / f"{name}.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


@pytest.mark.long
@pytest.mark.parametrize("row", rows_of("procedures"), ids=lambda row: f"{row['procedure']}-{row['world']}")
def test_a_verdict_of_the_page_is_that_of_today(two_worlds, row):
    procedures = two_worlds("procedures")
    found = procedures.run(row["procedure"], row["world"])
    assert (found["verdict"], [reported.split(" = ")[0] for reported in found["failed"]]) == (
        row["verdict"],
        [reported.split(" = ")[0] for reported in row["failed"]],
    )


@pytest.mark.long
@pytest.mark.parametrize("world", ["own", "creep", "holding"])
def test_the_first_line_up_the_wall_is_that_of_today(two_worlds, world):
    first = {"world": world, "case": "x_line", "feedback": "ekf", "seed": 0}
    row = next(row for row in rows_of("wall") if first.items() <= row.items())
    found = two_worlds("wall").drive(**first)
    for key in ("rmse_x", "rmse_y", "end_x", "end_y"):
        assert found[key] == pytest.approx(row[key], abs=0.25)
