"""Two campaigns held against each other, case by case."""

import json

import numpy as np
import pytest
from scipy import stats

from hil.cli import main


def campaign(folder, values, procedure="climb"):
    """A folder as `hil campaign` leaves it: case -> (verdict, end error in mm)."""
    rows = [
        {"case": case, "verdict": verdict, "measurements": {"end error": {"unit": "mm", "value": value}}}
        for case, (verdict, value) in values.items()
    ]
    folder.mkdir()
    tree = {"schema": 1, "procedure": procedure, "rows": rows}
    (folder / "campaign.json").write_text(json.dumps(tree))
    return str(folder)


@pytest.fixture
def two(tmp_path):
    """Worlds that differ by far more than the campaigns do; the second one is 1 mm better in each."""
    rng = np.random.default_rng(3)
    worlds = rng.uniform(5.0, 60.0, 20)
    gain = rng.normal(-1.0, 0.3, 20)
    first = {f"seed={k}": ("PASS" if v < 35 else "FAIL", v) for k, v in enumerate(worlds)}
    second = {f"seed={k}": ("PASS", v + g) for k, (v, g) in enumerate(zip(worlds, gain, strict=True))}
    del second["seed=19"]
    second["seed=77"] = ("PASS", 3.0)
    return campaign(tmp_path / "one", first), campaign(tmp_path / "two", second), gain[:19]


def test_pairs_show_what_averages_hide(two, capsys):
    first, second, gain = two
    assert main(["report", first, second, "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert (table["cases"], table["only_first"], table["only_second"]) == (19, ["seed=19"], ["seed=77"])
    (found,) = table["measurements"]
    assert found["change"] == pytest.approx(gain.mean())
    low, high = found["interval"]
    assert low < -1.0 < high < 0
    assert high - low == pytest.approx(2 * stats.t.ppf(0.975, 18) * gain.std(ddof=1) / np.sqrt(19))
    assert found["p"] < 1e-4
    flipped = table["verdicts"]["better"]
    assert len(flipped) > 1
    assert table["verdicts"]["p"] == pytest.approx(2 * 0.5 ** len(flipped))


def test_the_page_names_cases_and_draws_the_differences(two, capsys, tmp_path):
    first, second, _ = two
    assert main(["report", first, second]) == 0
    said = capsys.readouterr().out
    assert "climb: 19 cases in both" in said
    page = (tmp_path / "one" / "compare.html").read_text()
    assert "seed=19" in page
    assert page.count("<figure>") == 1


def test_campaigns_that_say_nothing_about_each_other_are_refused(tmp_path, capsys):
    a = campaign(tmp_path / "a", {"seed=1": ("PASS", 1.0)})
    b = campaign(tmp_path / "b", {"seed=2": ("PASS", 1.0)})
    c = campaign(tmp_path / "c", {"seed=1": ("PASS", 1.0)}, procedure="turn")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "campaign.json").write_text('{"schema": 1, "rows": 3}')
    for others, reported in (
        ((b,), "have no case in common"),
        ((c,), "different procedures: climb, turn"),
        ((str(tmp_path / "d"),), "is not the result of a campaign"),
        ((b, c), "3 campaigns to compare"),
        ((str(tmp_path / "none"),), "cannot be read"),
    ):
        assert main(["report", a, *others]) == 2
        assert reported in capsys.readouterr().err


def test_equal_campaigns_have_no_difference_and_no_doubt(tmp_path, capsys):
    first, second = ({f"seed={k}": ("PASS", k * (1.0 + off)) for k in range(4)} for off in (0.0, 1e-13))
    folders = [campaign(tmp_path / "a", first), campaign(tmp_path / "b", second)]
    assert main(["report", *folders, "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["measurements"]
    assert (found["change"], found["interval"], found["p"]) == (0.0, None, None)
    assert main(["report", *folders]) == 0
    assert '<div class="plot"' not in (tmp_path / "a" / "compare.html").read_text()


def test_cases_without_a_value_make_no_pair_and_are_named(tmp_path, capsys):
    whole = {f"seed={k}": ("PASS", 5.0 + k) for k in range(5)}
    holes = {**whole, "seed=1": ("ERROR", None), "seed=3": ("FAIL", None)}
    first, second = campaign(tmp_path / "one", whole), campaign(tmp_path / "two", holes)
    assert main(["report", first, second]) == 0
    assert "(3 of 5 pairs)" in capsys.readouterr().out
    page = (tmp_path / "one" / "compare.html").read_text()
    assert "<td>3 of 5</td>" in page
    assert "seed=1; seed=3" in page


def test_lost_cases_are_no_failures_and_are_left_out(tmp_path, capsys):
    whole = {f"seed={k}": ("PASS", 5.0 + k) for k in range(5)}
    holes = {**whole, "seed=1": ("LOST", None), "seed=3": ("LOST", None), "seed=4": ("FAIL", 40.0)}
    first, second = campaign(tmp_path / "one", whole), campaign(tmp_path / "two", holes)
    path = tmp_path / "one" / "campaign.json"
    tree = json.loads(path.read_text())
    tree["rows"][0]["faults_not_met"] = ["imu:off@500"]
    path.write_text(json.dumps(tree))
    assert main(["report", first, second, "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert (table["not_tested"], table["lost"]) == (["seed=0", "seed=1", "seed=3"], ["seed=1", "seed=3"])
    assert table["verdicts"] == {"good": [2, 1], "better": [], "worse": ["seed=4"], "p": 1.0}
    assert (table["measurements"][0]["pairs"], table["measurements"][0]["of"], table["missing"]) == (2, 2, [])
    page = (tmp_path / "one" / "compare.html").read_text()
    assert '<p class="words">seed=1; seed=3</p>' in page
    assert '<p class="words">seed=0</p>' in page


def test_what_they_were_given_differently_is_listed(tmp_path, capsys):
    values = {"seed=0": ("PASS", 5.0)}
    folders = [campaign(tmp_path / name, values) for name in ("one", "two")]
    assert main(["report", *folders]) == 0
    assert "not known: a plan.json is missing" in capsys.readouterr().out
    plan = {
        "script": "climb",
        "settings": ["gain=1", "bench.name=a"],
        "faults": [],
        "make": {"numpy": "2.0"},
        "contents": {"/x.toml": "ab" * 32},
    }
    other = {**plan, "settings": ["gain=2", "bench.name=a"], "faults": ["imu:off@1"]}
    (tmp_path / "one" / "plan.json").write_text(json.dumps(plan))
    for changed, reported in (
        (plan, ["the same options, files and versions in both"]),
        (other, ["  --set gain: 1 -> 2", "  --fault: – -> imu:off@1"]),
        ({**plan, "contents": {"/x.toml": "cd" * 32}}, ["  /x.toml: content abababab -> content cdcdcdcd"]),
    ):
        (tmp_path / "two" / "plan.json").write_text(json.dumps(changed))
        assert main(["report", *folders]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[-1 - len(reported) : -1] == reported
    assert "/x.toml" in (tmp_path / "one" / "compare.html").read_text()
