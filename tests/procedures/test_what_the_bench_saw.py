"""What the bench saw is told wherever a result is read, and no figure rests on a sensor that was left out."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from procedure_runs import options_of

from hil.cli.run import text_of
from hil.core.event_rows import MOST_ROWS, EventRows, event_line
from hil.core.signals import Event
from hil.faults.files import read_faults
from hil.procedure.bench_source import BenchSource
from hil.procedure.measurements import Verdict
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import run_procedure
from hil.report.run_page import write_run_page
from tests.patience import FANLESS

SHORT = {
    "cases": ["x_line"],
    "feedbacks": ["odometry", "ekf"],
    "optimal": False,
    "length_m": 0.1,
    "duration_s": 3.0,
    "hold_s": 0.5,
}


@pytest.fixture(scope="module")
def moved_frame(tmp_path_factory):
    """Two drives in which the frame of motion capture moves by 5 mm, less than any other check allows."""
    folder = tmp_path_factory.mktemp("saw") / "run"
    source = BenchSource(
        "emulated", faults=read_faults(("mocap:wrong@2.0,offset_m=0.005",)), overrides=FANLESS
    )
    return run_procedure(load_procedure("wall_tracking"), source, options_of(folder, SHORT))


def test_figures_come_from_what_is_believed_or_are_not_measured(moved_frame):
    rows = {row["name"]: row for row in moved_frame.to_json()["measurements"]}
    end = rows["x_line.ekf.end"]
    assert end["value"] < 3.0, "the figure is that of a frame that has moved by 5 mm"
    assert "by the estimate" in end["doubt"]
    assert "motion capture was left out" in end["doubt"]
    shortfall = rows["x_line.odometry.shortfall"]
    assert (shortfall["value"], shortfall["outcome"]) == (None, "FAIL"), "wheels alone are no truth"
    assert "not measured" in shortfall["doubt"]
    assert moved_frame.verdict is Verdict.FAIL


def test_it_is_told_in_every_result(moved_frame):
    tree = json.loads((moved_frame.folder / "result.json").read_text())
    told = [row for row in tree["events"] if row["device"] == "mocap" and row["left_out"]]
    assert [row["bench"] for row in told] == [
        "bench 1 (x_line odometry seed 0)",
        "bench 2 (x_line ekf seed 0)",
    ]
    assert all(2.1 <= row["t_s"] < 2.3 and row["level"] == "warning" for row in told)
    junit = ElementTree.parse(moved_frame.folder / "junit.xml").getroot()
    events = [p.get("value") for p in junit.iter("property") if p.get("name") == "event"]
    case = next(c for c in junit.iter("testcase") if c.get("name") == "x_line.ekf.end")
    page, text = write_run_page(moved_frame.folder).read_text(), text_of(moved_frame)
    for row in told:
        assert event_line(row) in events
        assert row["what"] in page
        assert row["what"] in text.partition("HELD")[0].partition("seen:")[2], "the last lines tell it"
    assert "by the estimate" in case.findtext("system-out")


def test_a_flood_is_one_line_with_a_count():
    rows = EventRows(("warning",))
    stale = Event(0, "warning", "tracker", "stale for 0.1 s")
    for k in range(500):
        rows.add(replace(stale, message=f"stale for {0.1 * k:.3f} s"), 0.01 * k)
        rows.add(replace(stale, level="info", message="answers again"), 0.01 * k)
    (row,) = rows.rows()
    assert (row["t_s"], row["count"], row["last_s"]) == (0.0, 500, 4.99)
    for k in range(2 * MOST_ROWS):
        rows.add(replace(stale, source=f"own_{chr(97 + k % 26)}{chr(97 + k // 26)}"), 9.0)
    assert (len(rows.rows()), rows.further) == (MOST_ROWS, MOST_ROWS + 1)
