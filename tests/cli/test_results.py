"""`hil results`: what earlier runs left is listed, opened, searched and followed."""

import errno
import json
import re
from pathlib import Path

import pytest

from hil.cli import main
from hil.procedure.measurements import Verdict

SCRIPT = '''
"""Nothing to do."""
from hil.procedure import Measurement, procedure


@procedure(name="idle", needs=(), measurements=[Measurement("width", "mm", high=6.0)])
def run(ctx):
    """Do nothing."""
    ctx.measure("width", 5.0)
'''


@pytest.fixture
def place(tmp_path, monkeypatch, capsys):
    """A folder in which a run was made, and a result of another version lies."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "idle.py").write_text(SCRIPT)
    assert main(["run", "idle.py", "--out", "out/idle/one"]) == 0
    (tmp_path / "out" / "newer").mkdir()
    (tmp_path / "out" / "newer" / "result.json").write_text('{"schema": 2, "procedure": "idle"}')
    capsys.readouterr()
    return tmp_path


def call(capsys, *words):
    code = main(["results", *words])
    return code, *capsys.readouterr()


def test_the_list_says_what_ran_where_with_which_verdict_and_figures(place, capsys):
    code, out, _ = call(capsys, "list")
    assert code == 0
    (row,) = [line for line in out.splitlines() if line.endswith("idle/one")]
    assert {"PASS", "idle", "emulated", "(emulated)"} <= set(row.split())
    assert "width 5 mm (at most 6)" in out
    assert "schema 2" in out
    reported = json.loads(call(capsys, "list", "--json", "--verdict", "pass")[1])
    assert [(r["name"], r["measurements"]) for r in reported["results"]] == [("idle/one", {"width": 5.0})]


def test_of_a_run_that_broke_off_the_list_says_why(place, capsys):
    (place / "idle.py").write_text(
        SCRIPT.replace('ctx.measure("width", 5.0)', 'raise RuntimeError("no lamp")')
    )
    assert main(["run", "idle.py", "--out", "out/idle/two"]) == 2
    capsys.readouterr()
    assert "no lamp" in call(capsys, "list", "--verdict", "error")[1]


def test_a_search_finds_by_any_word_and_says_when_nothing_fits(place, capsys):
    assert "idle/one" in call(capsys, "search", "WIDTH")[1]
    assert "fits" in call(capsys, "search", "width", "nowhere")[1]
    assert "1 more; --limit 2 shows all" in call(capsys, "list", "--limit", "1")[1]


def test_the_page_of_a_run_is_named_and_written_again_where_it_is_missing(place, capsys):
    page = place / "out" / "idle" / "one" / "report.html"
    page.unlink()
    code, out, _ = call(capsys, "open", "idle/one")
    assert (code, out.strip()) == (0, "out/idle/one/report.html")
    assert page.stat().st_size > 5000
    assert call(capsys, "open")[1].strip() == "out/idle/one/report.html"
    assert call(capsys, "open", "newer")[0] == 2


def test_a_verdict_or_a_day_that_is_none_is_refused_with_what_there_is(place, capsys):
    code, _, said = call(capsys, "list", "--verdict", "GREEN")
    assert code == 2
    assert {v.value for v in Verdict} <= set(re.findall(r"[A-Z]+", said))
    assert call(capsys, "list", "--since", "yesterday")[0] == 2
    assert "idle/one" in call(capsys, "list", "--since", "2020-01-31", "--verdict", "pass")[1]
    assert "idle/one" not in call(capsys, "list", "--since", "2999-01-31")[1]


def test_trends_of_a_folder_without_runs_write_no_page(tmp_path, capsys):
    code, *_ = call(capsys, "trends", "--in", str(tmp_path))
    assert (code, list(tmp_path.iterdir())) == (0, [])
    assert json.loads(call(capsys, "trends", "--in", str(tmp_path), "--json")[1]) == {
        "page": None,
        "groups": [],
    }


def test_a_path_that_is_refused_is_reported_without_numbers_of_the_system(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["accept", "--answers", "nope"]) == 2
    said = capsys.readouterr().err
    assert "No such file or directory" in said
    assert "Errno" not in said

    def denied(*_args, **_keys):
        raise PermissionError(errno.EACCES, "Permission denied")

    (tmp_path / "idle.py").write_text(SCRIPT)
    for command, out in (("run", "idle.py"), ("campaign", "idle.py/new")):
        assert main([command, "idle.py", "--out", out]) == 2
        assert f"{out}: is a file, or lies in one" in capsys.readouterr().err
    monkeypatch.setattr(Path, "mkdir", denied)
    assert main(["run", "idle.py", "--out", "new"]) == 2
    said = capsys.readouterr().err
    assert "Permission denied" in said
    assert "Errno" not in said


def test_trends_write_a_page_and_a_gate_for_ci(place, capsys):
    for number in range(2, 12):
        tree = json.loads((place / "out" / "idle" / "one" / "result.json").read_text())
        tree["measurements"][0]["value"] = 5.0 + 0.01 * number
        tree["started"] = f"2027-01-{number:02}T10:00:00+00:00"
        (place / "out" / "idle" / str(number)).mkdir()
        (place / "out" / "idle" / str(number) / "result.json").write_text(json.dumps(tree))
    code, out, _ = call(capsys, "trends")
    assert code == 0
    assert "width drifts by +0.01 mm a run" in out
    assert (place / "out" / "trends.html").stat().st_size > 4000
    assert call(capsys, "trends", "--strict", "--out", "elsewhere.html")[0] == 1
    reported = json.loads(call(capsys, "trends", "--json")[1])
    assert reported["groups"][0]["measurements"][0]["state"] == "drifting"


def test_a_folder_without_results_is_reported(place, capsys):
    (place / "empty").mkdir()
    assert "nothing in empty fits" in call(capsys, "list", "--in", "empty")[1]
    assert call(capsys, "list", "--in", "absent")[0] == 2
