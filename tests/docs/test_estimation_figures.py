"""The figures of docs/estimation.md are those of the demo's recordings, as they are driven now."""

import runpy
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


def rows(text):
    """Figures by estimator of one replayed recording."""
    cells = [line.split() for line in text.splitlines()[2:7]]
    return {name: [np.nan if v == "-" else float(v) for v in values] for name, *values in cells}


@pytest.mark.long
def test_the_table_of_the_x_line_is_what_replay_prints_today(tmp_path):
    """`python docs/make_estimation_figures.py` writes it anew."""
    script = runpy.run_path(str(DOCS / "make_estimation_figures.py"))
    script["drive"](tmp_path / "run", ["x_line"])
    printed = script["block"](tmp_path / "run", ["x_line"])
    page = (DOCS / "estimation.md").read_text(encoding="utf-8")
    assert script["with_block"](page, "") != page
    begin = page.index(printed.splitlines()[0])
    shown, now = rows(page[begin:]), rows(printed)
    assert list(shown) == list(now) == ["recorded", "odometry", "ekf", "ukf", "smoother"]
    for name, figures in now.items():
        np.testing.assert_allclose(shown[name], figures, rtol=1e-3, atol=2e-3, err_msg=name)
