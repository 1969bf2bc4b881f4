"""What the first sentences of campaigns and calibrations say; warnings once, and no curve hidden."""

import html
import re
from types import SimpleNamespace

import numpy as np

from hil.procedure.campaign.page import write_campaign_page
from hil.procedure.campaign.plan import Case
from hil.procedure.campaign.table import Row
from hil.report.calibration_page import _sentence
from hil.report.compare_page import _change
from hil.report.overview import Overview, write_overview
from hil.report.run_plots import legend, new_figure, style


def lead(path):
    return html.unescape(re.search(r'<p class="lead">(.*?)</p>', path.read_text(encoding="utf-8"), re.S)[1])


def test_a_campaign_says_which_limits_were_missed_and_how_often(tmp_path):
    def row(seed, *failed, error=""):
        limits = {"unit": "mm", "value": 1.0, "low": None, "high": 2.0, "missing": ""}
        measured = {n: limits | {"outcome": "FAIL" if n in failed else "PASS"} for n in ("end", "way")}
        measured = {} if error else measured
        verdict = "ERROR" if error else "FAIL" if failed else "PASS"
        return Row(Case(seed), str(tmp_path / str(seed)), verdict, 0, 1.0, {} if error else measured, error)

    rows = [row(1), row(2, "end"), row(3, "end", "way"), row(4, error="it fell")]
    tree = {
        "procedure": "short",
        "cases": 4,
        "planned": 4,
        "verdicts": {"PASS": 1, "FAIL": 2, "ERROR": 1},
        "verdict": "ERROR",
        "summary": "",
        "bench": "b",
        "groups": [],
        "alike": [],
        "rows": [{"case": r.case.name, "command": "hil"} for r in rows],
    }
    said = lead(write_campaign_page(tmp_path / "page.html", tree, rows))
    assert said == "1 of 4 runs kept their limits. Beyond its limit: end in 2, way in 1. 1 ended early."


def test_a_calibration_names_recordings_that_were_left_out():
    tables = tuple({"mean": {"rmse_position_m": m}} for m in (0.04, 0.025))

    def said(*rejected):
        result = SimpleNamespace(validation={}, rejected=dict.fromkeys(rejected, "why"), recordings=[0] * 18)
        return _sentence(tables, result)

    assert said().endswith("from 40.0 to 25.0 mm (RMSE) on the recordings that it was fitted to.")
    assert said("a").endswith("fitted to. Left out: 1 of 19 recordings, a (see the warnings).")
    assert said("a", "b").endswith("Left out: 2 of 20 recordings, a, b (see the warnings).")


def test_a_warning_stands_on_a_page_once(tmp_path):
    page = Overview("title", "A sentence.", [], [], ["odom: one gap", "slow link", "odom: one gap"])
    text = write_overview(tmp_path / "page.html", page).read_text()
    assert (text.count("odom: one gap"), text.count("slow link")) == (1, 1)


def test_a_legend_above_hides_no_curve():
    figure = new_figure()
    axes = style(figure.add_subplot(), "time (s)", "x (mm)")
    for k in range(5):
        axes.plot(np.arange(9), np.full(9, k), label=f"estimator {k}")
    legend(axes, columns=3, above=True)
    figure.canvas.draw()
    assert axes.get_legend().get_window_extent().y0 >= axes.get_window_extent().y1


def test_no_change_is_no_signed_zero():
    assert [_change({"change": v}) for v in (0.0, -0.5, 2.0, None)] == ["0", "-0.5", "+2", ""]
