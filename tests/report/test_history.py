"""What a folder of results holds is found and followed over time; what cannot be read is named."""

import json
import os
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from hil.config.bench import BenchConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError, UsageError
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.history.chart import DRIFTING, OUTSIDE, STEADY, TOO_FEW, individuals_chart
from hil.report.history.index import UNFINISHED, find_results
from hil.report.history.opening import page_of
from hil.report.history.page import drawing, headline, write_trends_page
from hil.report.history.query import chosen, named
from hil.report.history.series import groups
from hil.report.run_page import write_run_page

NOISE = np.random.default_rng(1).normal(0.0, 0.1, 40)
BEGIN = datetime(2026, 3, 1, tzinfo=timezone.utc)


@procedure(name="gap", measurements=(Measurement("width", "mm", high=6.0), Measurement("seen", "1")))
def gap(ctx):
    """Measure a gap."""
    ctx.measure("width", 5.0)
    ctx.measure("seen", 1.0)
    ctx.note("the lamp was on")


@procedure(name="struck", measurements=())
def struck(ctx):
    """Look at its own folder while it runs."""
    (ctx.folder / "seen_from_inside.json").write_text(
        json.dumps([k.why for k in find_results(ctx.folder.parent)])
    )


def files_of(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def run(proc, folder, started="2026-03-01T10:00:00+00:00"):
    source = BenchSource(BenchConfig(schema=1, name="lab"))
    return run_procedure(proc, source, RunOptions(folder, MonotonicClock(), started, {}))


@pytest.fixture
def root(tmp_path):
    """A folder with one of everything."""
    out = tmp_path / "out"
    run(gap, out / "gap" / "one")
    run(struck, out / "struck" / "cut")
    (out / "struck" / "cut" / "result.json").unlink()
    for name, text in {
        "newer/result.json": '{"schema": 2, "procedure": "gap"}',
        "torn/result.json": '{"schema": 1, "proc',
        "list/result.json": "[]",
        "other/result.json": '{"name": "of another program"}',
        "page/index.html": "<html><title>Bench &amp; <i>co</i></title>",
        "junk/journal.jsonl": "\x00\x01",
        "gap/one/figures/page.html": "<title>an attachment</title>",
        "trial/plan.json": '{"schema": 1, "procedure": "gap"}',
        "trial/campaign.json": '{"procedure": "gap", "verdict": "FAIL", "cases": 2, "bench": "lab"}',
        "accept/accept.json": json.dumps(
            {
                "verdict": "FAIL",
                "bench": "lab",
                "began": "2026-03-01T12:00:00+00:00",
                "devices": {"imu": {"backend": "real"}},
                "stages": [{"name": "doctor", "why": "1 of 4 checks failed (imu)"}],
            }
        ),
        "accept/accept.html": "<title>FAIL: acceptance of lab</title>",
        "signed/accept.json": '{"verdict": "PASS"}',
        "whole/commission.json": '{"options": {"bench": "lab"}, "done": {"gap": {"verdict": "FAIL"}}}',
    }.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(text)
    os.mkfifo(out / "page" / "result.json")
    run(gap, out / "trial" / "runs" / "seed_0")
    return out


def test_everything_is_shown_as_what_it_is(root):
    found = {k.name: k for k in find_results(root)}
    assert {name: k.kind for name, k in found.items()} == {
        "gap/one": "run",
        "trial": "campaign",
        "trial/runs/seed_0": "run",
        "whole": "commissioning",
        "struck/cut": "unfinished",
        "newer": "foreign",
        "torn": "foreign",
        "list": "foreign",
        "other": "foreign",
        "page": "foreign",
        "junk": "foreign",
        "accept": "acceptance",
        "signed": "foreign",
    }
    one = found["gap/one"]
    assert (one.what, one.bench, one.where, one.verdict) == ("gap", "lab", "emulated", "PASS")
    assert one.when == datetime(2026, 3, 1, 10, tzinfo=timezone.utc)
    assert "another version of hil (schema 2" in found["newer"].why
    assert "not JSON" in found["torn"].why
    assert "not a JSON object" in found["list"].why
    assert "not the result of a run" in found["other"].why
    assert found["page"].what == "Bench & <i>co</i>"
    assert "struck down" in found["struck/cut"].why
    assert (found["trial"].verdict, found["trial/runs/seed_0"].within) == ("FAIL", "trial")
    assert (found["whole"].verdict, found["whole"].why) == ("FAIL", "1 procedures, stopped at gap")


def test_an_acceptance_is_listed_with_its_verdict_and_its_page_opens(root):
    kept = named(find_results(root), "accept")
    assert (kept.what, kept.bench, kept.where, kept.verdict) == ("acceptance", "lab", "hardware", "FAIL")
    assert (kept.when, kept.why) == (
        datetime(2026, 3, 1, 12, tzinfo=timezone.utc),
        "doctor: 1 of 4 checks failed (imu)",
    )
    assert page_of(kept) == root / "accept" / "accept.html"


def test_a_run_that_goes_on_is_known_by_the_lock_on_its_journal(root):
    (said,) = json.loads((root / "struck" / "cut" / "seen_from_inside.json").read_text())
    assert said == "still running"


def test_a_folder_that_is_a_run_itself_does_not_hide_what_lies_below(root):
    (root / "result.json").write_text((root / "gap" / "one" / "result.json").read_text())
    names = {k.name for k in find_results(root)}
    assert {".", "gap/one"} <= names


def test_a_run_is_found_by_its_seed(tmp_path):
    for seed in (3, 4):
        write(tmp_path / f"run{seed}", seed, seed=seed)
    write(tmp_path / "none", 5, seed=None)
    assert [k.name for k in chosen(find_results(tmp_path), words=["seed=3"])] == ["run3"]
    assert len(chosen(find_results(tmp_path), words=["seed="])) == 2


CHOSEN = (
    ({"procedure": "gap"}, {"gap/one", "trial"}),
    ({"procedure": "gap", "within": True}, {"gap/one", "trial", "trial/runs/seed_0"}),
    ({"verdict": "fail"}, {"accept", "trial", "whole"}),
    ({"words": ["lamp"]}, {"gap/one"}),
    ({"words": ["width", "lab"]}, {"gap/one"}),
    ({"words": ["no such word"]}, set()),
    ({"bench": "lab", "since": datetime(2026, 3, 2, tzinfo=timezone.utc)}, {"trial", "whole"}),
)


def test_results_are_chosen_by_what_they_say(root):
    found = find_results(root)
    for asked, names in CHOSEN:
        assert {k.name for k in chosen(found, **asked)} == names, asked


def test_one_is_called_by_its_name_its_folder_or_a_part_of_its_name(root):
    found = find_results(root)
    for name in ("gap/one", str(root / "gap" / "one"), "p/on"):
        assert named(found, name).name == "gap/one"
    assert named(found, "last").kind in ("campaign", "commissioning")
    begun = [replace(k, kind=UNFINISHED) for k in found if k.kind == "run"]
    assert named([*begun, *found], "last") == named(found, "last")  # what was broken off has no page
    with pytest.raises(UsageError, match="did you mean gap/one"):
        named(found, "gap/onee")
    with pytest.raises(UsageError, match="names 2 results: trial"):
        named(found, "tri")
    with pytest.raises(UsageError, match="no result is called 'p/on'"):
        named(found, "p/on", whole=True)


CONTRADICTIONS = (
    ({"verdict": "SPLENDID"}, {}, "verdict: Input should be 'PASS'"),
    ({}, {"outcome": "FAIL"}, "verdict PASS, but width is FAIL"),
    ({}, {"outcome": "MARGINAL"}, "verdict PASS, but a measurement is MARGINAL"),
    ({}, {"value": 6.5}, "width is PASS with a value beyond its limit"),
    ({"verdict": "FAIL"}, {}, "verdict FAIL, but no measurement is"),
    ({"error": {"type": "x", "message": "y"}}, {}, "verdict PASS, but it ended in an error"),
)


def test_a_result_that_contradicts_itself_is_not_believed(tmp_path):
    run(gap, tmp_path / "one")
    path = tmp_path / "one" / "result.json"
    whole = path.read_text()
    for change, measured, why in CONTRADICTIONS:
        tree = json.loads(whole) | change
        tree["measurements"][0] |= measured
        path.write_text(json.dumps(tree))
        (kept,) = find_results(tmp_path)
        assert (kept.kind, kept.verdict) == ("foreign", "")
        assert why in kept.why
        with pytest.raises(DataError, match=re.escape(why)):
            write_run_page(path.parent)


@pytest.mark.parametrize(
    ("values", "state"),
    [
        (NOISE[:8], TOO_FEW),
        (NOISE, STEADY),
        ([2.0] * 12, STEADY),
        ([2.0] * 12 + [2.1], OUTSIDE),
        ([*NOISE[:20], 1.0], OUTSIDE),
        (NOISE[:20] + 0.05 * np.arange(20), DRIFTING),
    ],
)
def test_a_series_is_judged(values, state):
    assert individuals_chart(list(values), None, None).state == state


def test_a_drift_is_named_long_before_it_meets_its_limit():
    values = 1.0 + NOISE + 0.03 * np.arange(40)
    first = next(n for n in range(9, 40) if individuals_chart(values[:n], None, 3.0).state == DRIFTING)
    chart = individuals_chart(values[:first], None, 3.0)
    assert first < 25
    assert values[:first].max() < 2.0
    assert first + chart.runs_left == pytest.approx((3.0 - 1.0) / 0.03, abs=25)
    assert individuals_chart(-values[:first], None, 3.0).runs_left is None


def test_control_limits_are_those_of_the_textbook():
    """Mean and 2.66 mean moving ranges, by hand."""
    values = [10.0, 12.0, 11.0, 13.0, 12.0, 10.0, 11.0, 12.0, 11.0]
    chart = individuals_chart(values, None, None)
    ranges = [2, 1, 2, 1, 2, 1, 1]
    assert chart.centre == pytest.approx(91 / 8)
    assert chart.high - chart.centre == pytest.approx(2.66 * sum(ranges) / 7)
    assert chart.centre - chart.low == pytest.approx(2.66 * sum(ranges) / 7)


def write(folder, number, **changed):
    """A result by hand: the width drifts from the 20th run on, with another calibration from the 10th on."""
    value = 4.0 + 0.05 * max(0, number - 10) + NOISE[number]
    tree = {
        "schema": 1,
        "procedure": "gap",
        "verdict": "PASS",
        "bench": "lab",
        "virtual_time": False,
        "started": (BEGIN + timedelta(days=number)).isoformat(),
        "calibration": {"path": "c.toml", "version": 1 + (number >= 10), "sha256": f"{number >= 10}" * 4},
        "measurements": [
            {"name": "width", "unit": "mm", "value": value, "high": 6.0, "outcome": "PASS"},
            {"name": "seen", "unit": "1", "value": 1.0, "outcome": "PASS", "limited": False},
        ],
    } | changed
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps(tree))


@pytest.fixture
def drifted(tmp_path):
    """30 runs on one bench, and some that cannot be compared with them."""
    for number in range(30):
        write(tmp_path / f"{number:02}", number)
    write(tmp_path / "aborted", 31, verdict="ABORTED")
    write(tmp_path / "emulated", 32, virtual_time=True)
    write(tmp_path / "faulty", 33, faults=["imu:off"])
    return tmp_path


def test_runs_that_can_be_compared_stand_together_and_the_drift_comes_first(drifted):
    first, *others = groups(find_results(drifted))
    assert first.title == "gap on lab (hardware)"
    assert len(first.runs) == 30
    assert [(s.name, s.chart.state) for s in first.series] == [("width", DRIFTING), ("seen", STEADY)]
    assert sorted(len(g.runs) for g in others) == [1, 1]
    assert "meets its limit of 6 mm in" in first.series[0].in_words()
    assert [p.calibration for p in first.series[0].points][9:11] == [
        "version 1 (FalseF)",
        "version 2 (TrueTr)",
    ]
    assert headline([first]) == "2 measurements in 30 runs: 1 drifting, 1 steady."


def test_another_emulated_robot_is_another_history(tmp_path):
    """A seed is a robot: what differs between two is no drift of one."""
    for number, seed in enumerate((7, 7, 8)):
        write(tmp_path / f"{number}", number, seed=seed, emulated=["servos"], faults=["imu:off@1"])
    one, other = sorted(groups(find_results(tmp_path)), key=lambda g: len(g.runs))
    assert (len(one.runs), len(other.runs)) == (1, 2)
    assert one.title.endswith(", faults imu:off@1; seed 8")
    assert one.series[0].in_words() == "1 run: too few to judge"


def test_the_page_draws_limits_calibrations_and_every_run(drifted):
    found = groups(find_results(drifted))
    art = drawing(found[0].series[0])
    assert (len(art["points"]), len(art["lines"]), len(art["control"])) == (30, 2, 2)
    assert [c["words"] for c in art["calibrations"]] == ["calibration version 2 (TrueTr)"]
    assert len(art["limits"]) == 1
    assert all(0 <= p["x"] <= 320 and 0 <= p["y"] <= 110 for p in art["points"])
    page = write_trends_page(drifted / "trends.html", found).read_text()
    assert page.count("<circle") == 30 * 2  # what has one value only is not drawn
    assert "version 2 (TrueTr)" in page
    assert page.count('class="tick"') == 2 * sum(len(s.points) > 1 for g in found for s in g.series)
    assert (art["top"], "2026-03-01 00:00" in page) == ("6 mm", True)
    assert "nan" not in page
    assert not re.search(r"https?://(?!www\.w3\.org)", page)


def test_names_from_elsewhere_are_only_text_on_the_page(tmp_path):
    write(tmp_path / "x", 1, bench="<script>alert(1)</script>")
    page = write_trends_page(tmp_path / "t.html", groups(find_results(tmp_path))).read_text()
    assert page.count("<script") == 1
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in page


SESSION = {"command": "live", "began": "2026-03-01T10:00:00+00:00", "bench": "lab", "emulated": ["imu"]}
SESSION["real"] = ["servos"]


@pytest.mark.parametrize(
    ("change", "kind", "why"),
    [
        ({"ended": "key x", "held": {"state": "HELD"}}, "live", "ended by: key x; HELD"),
        ({}, "live", "it still runs, or was killed"),
        ({"ended": "SIGINT", "held": {"state": "HELD"}}, "live", "ended by: Ctrl-C or STOP; HELD"),
        ({"began": 3}, "foreign", "session.json is of no live session"),
    ],
)
def test_a_live_session_is_listed_also_one_that_was_killed(tmp_path, change, kind, why):
    folder = tmp_path / "live" / "one"
    folder.mkdir(parents=True)
    (folder / "session.json").write_text(json.dumps(SESSION | change))
    (kept,) = find_results(tmp_path)
    assert (kept.kind, kept.why) == (kind, why)
    if kind == "live":
        assert (kept.what, kept.where, kept.when.hour) == ("live", "real time, emulated: imu", 10)


@pytest.mark.parametrize(
    ("ended", "state", "verdict"),
    [
        ("key x", "HELD", "DONE"),
        ("duration", "not needed", "DONE"),
        ("SIGTERM", "HELD", "ENDED"),
        ("SIGTERM", "NOT HELD", "NOT HELD"),
        ("robot stopped (adhesion): no air", "HELD", "ERROR"),
        ("gamepad lost", "HELD", "ERROR"),
    ],
)
def test_a_session_is_listed_with_what_it_moved_its_faults_and_how_it_ended(tmp_path, ended, state, verdict):
    more = {"command": "jog", "moves": "wheel FL", "faults": ["adhesion:off@16"]}
    tree = SESSION | more | {"ended": ended, "held": {"state": state}}
    (tmp_path / "session.json").write_text(json.dumps(tree))
    (kept,) = find_results(tmp_path)
    assert (kept.what, kept.verdict) == ("jog wheel FL", verdict)
    assert kept.why.startswith("with adhesion:off@16; ended by: ")
