"""The table of runs on a campaign's page: each value below its heading, and no column that is empty."""

import re

import pytest

from hil.cli import main

SCRIPT = '''
from hil.procedure import Measurement, procedure


@procedure(name="three", needs=(), measurements=[Measurement("found", "mm")])
def run(ctx):
    """Measure, or fail."""
    with ctx.step("a step"):
        ctx.measure("found", 1.0)
        {more}
'''


@pytest.mark.parametrize(("more", "has_errors"), [("pass", False), ("raise ValueError('no')", True)])
def test_runs_have_a_column_of_errors_only_where_one_has_an_error(tmp_path, monkeypatch, more, has_errors):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "three.py").write_text(SCRIPT.format(more=more))
    main(["campaign", "three.py", "--seeds", "0:2", "--workers", "0", "--keep", "results", "--out", "o"])
    runs = (tmp_path / "o" / "campaign.html").read_text().partition("<h2>Runs</h2>")[2]
    head, *rows = re.findall(r"<tr>(.*?)</tr>", runs, re.S)
    titles = re.findall(r"<th[^>]*>(.*?)</th>", head)
    assert ("error" in titles) == has_errors
    assert len(rows) == 2
    for cells in rows:
        assert cells.count("<td") == len(titles)
    assert titles[-1] == "again"
