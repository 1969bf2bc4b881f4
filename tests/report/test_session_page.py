"""The page of a live session: what ended it, its faults, its events, and figures of its recording."""

import json
import re

import pytest

from hil.bench import open_bench
from hil.cli import main
from hil.core.errors import DataError, SafetyStop
from hil.recording.mcap_writer import McapRecorder
from hil.report.history.index import find_results
from hil.report.history.opening import page_of
from hil.robot.trajectories import line

FAULT = "adhesion:off@2.5"
SESSION = {"command": "live", "moves": "", "began": "2026-03-01T10:00:00+00:00", "bench": "emulated"}
SESSION |= {"emulated": ["servos"], "real": [], "faults": [FAULT]}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Folder and summary of a drive up the wall that ends with the fan."""
    folder = tmp_path_factory.mktemp("out") / "live" / "one"
    folder.mkdir(parents=True)
    with open_bench("emulated", faults=[FAULT]) as bench:
        bench.add_sink(McapRecorder(folder / "recording.mcap", bench.header(), lossless=True))
        with pytest.raises(SafetyStop) as stop:
            bench.drive(line((0, 0, 0), (0.3, 0, 0), duration_s=8.0), feedback="odometry")
    ended = {"ended": str(stop.value), "held": bench.held.to_json(), "events": bench.seen.rows()}
    ended["samples"] = {"imu": {"received": 7, "missing": 1, "bad": {"stuck": 3}}}
    return folder, SESSION | ended


def titles(page):
    return re.findall(r"<figure><h3>(.*?)</h3>", page)


def test_the_page_says_how_it_ended_with_which_fault_and_draws_what_was_recorded(session, capsys):
    folder, tree = session
    (folder / "session.json").write_text(json.dumps(tree))
    (kept,) = find_results(folder.parent.parent)
    assert kept.verdict == tree["held"]["state"] == "NOT HELD"
    assert main(["results", "open", "one", "--in", str(folder.parent.parent), "--json"]) == 0
    page = page_of(kept).read_text()
    assert json.loads(capsys.readouterr().out)["page"] == str(page_of(kept))
    assert tree["ended"].partition(":")[0] in page
    assert FAULT in page
    assert tree["events"][0]["what"][:20] in page
    assert titles(page) == ["Wheels", "Path", "Adhesion"]
    assert str(folder / "recording.mcap") in page
    assert "3 stuck" in page


def test_a_killed_session_has_a_page_that_is_written_anew(session):
    folder, _ = session
    (folder / "session.html").write_text("an old page")
    (folder / "session.json").write_text(json.dumps(SESSION))
    (kept,) = find_results(folder.parent.parent)
    page = page_of(kept).read_text()
    assert "was killed" in page
    assert "Wheels" in titles(page)


def test_a_session_without_a_recording_has_a_page_without_figures(tmp_path):
    (tmp_path / "session.json").write_text(json.dumps(SESSION))
    (kept,) = find_results(tmp_path)
    assert titles(page_of(kept).read_text()) == []
    (tmp_path / "session.json").write_text("[]")
    with pytest.raises(DataError):
        page_of(kept)
