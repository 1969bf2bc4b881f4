"""A measurement that has stopped existing is no steady one: trends name it, and --strict ends with 1."""

import json
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from hil.cli import main

BEGIN = datetime(2030, 3, 1, tzinfo=timezone.utc)
NOISE = np.random.default_rng(2).normal(0.0, 0.1, 40)


def write(root, day, verdict="PASS", **values):
    """A run by hand; a value of None is one that was not measured or no finite number."""
    rows = [
        {"name": name, "unit": "mm", "value": value, "outcome": "FAIL" if value is None else "PASS"}
        for name, value in values.items()
    ]
    tree = {
        "schema": 1,
        "procedure": "gap",
        "verdict": verdict,
        "bench": "lab",
        "measurements": rows,
        "started": (BEGIN + timedelta(days=day)).isoformat(),
    }
    (root / f"{day:02}").mkdir()
    (root / f"{day:02}" / "result.json").write_text(json.dumps(tree))


@pytest.fixture
def trends(tmp_path, capsys):
    """Exit code and words of `hil results trends --strict`."""

    def look(*options):
        code = main(["results", "trends", "--strict", "--in", str(tmp_path), *options])
        return code, capsys.readouterr().out

    for day in range(22):
        write(tmp_path, day, one=5.0 + NOISE[day], two=3.0 + NOISE[-day])
    return look


@pytest.mark.parametrize(
    ("verdict", "left"), [("FAIL", {"two": None}), ("PASS", {})], ids=["no number", "not among them"]
)
def test_a_measurement_without_a_value_in_the_newest_runs_is_named(trends, tmp_path, verdict, left):
    for day in range(22, 30):
        write(tmp_path, day, verdict, one=5.0 + NOISE[day], **left)
    code, said = trends()
    assert code == 1
    assert "2 measurements in 30 runs: 1 without a value in the newest runs, 1 steady." in said
    assert (
        "gap on lab (hardware): 30 runs, 1 to look at\n    two no value in the last 8 runs; before: s" in said
    )
    page = (tmp_path / "trends.html").read_text()
    assert '<div class="trend missing"><b>two</b>' in page
    assert "no value in the last 8 runs; before: steady" in page
    found = json.loads(trends("--json")[1])["groups"][0]["measurements"][0]
    assert found["name"] == "two"
    assert (found["state"], found["missing"], len(found["values"])) == ("missing", 8, 22)


def test_a_run_that_ended_early_counts_where_its_kind_had_the_measurement(trends, tmp_path):
    write(tmp_path, 22, "ERROR", one=5.0, two=None)
    write(tmp_path, 23, "ABORTED")
    code, said = trends()
    assert (code, "22 runs and 2 that ended early, 2 to look at" in said) == (1, True), said
    assert "one no value in the last run;" in said
    assert "two no value in the last 2 runs;" in said


def test_a_value_that_comes_back_is_followed_on(trends, tmp_path):
    code, said = trends()
    assert (code, "2 steady." in said) == (0, True), said
    write(tmp_path, 22, "ERROR")
    write(tmp_path, 23, one=5.0, two=3.0)
    assert trends()[0] == 0


def test_runs_of_another_kind_that_ended_early_say_nothing(trends, tmp_path):
    write(tmp_path, 22, "ERROR")
    tree = json.loads((tmp_path / "22" / "result.json").read_text())
    (tmp_path / "22" / "result.json").write_text(json.dumps({**tree, "procedure": "other"}))
    code, said = trends()
    assert (code, "other on lab" in said) == (0, False), said


def test_what_no_run_has_a_value_of_is_named_and_not_drawn(tmp_path, capsys):
    for day in range(3):
        write(tmp_path, day, "FAIL", never=None)
    assert main(["results", "trends", "--strict", "--in", str(tmp_path)]) == 1
    assert "never no value in any run (3)" in capsys.readouterr().out
    page = (tmp_path / "trends.html").read_text()
    assert "no value in any run (3)" in page
    assert '<svg class="drawn"' not in page
