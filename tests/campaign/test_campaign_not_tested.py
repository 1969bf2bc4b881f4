"""A fault that never acted is not withstood: such a run counts as neither good nor bad, and is reported."""

import csv
import errno
import json
import os

import pytest

from hil.campaign import Case, Row, summarise
from hil.cli import main
from hil.procedure import run_result as result_files

SCRIPT = '''
"""Hold for as long as the seed says."""
from hil.procedure import Measurement, procedure


@procedure(name="hold", needs=("mocap",), measurements=[Measurement("held", "s", low=0.1)])
def run(ctx):
    """Hold."""
    held_s = 0.3 + 0.5 * ctx.seed
    ctx.bench.observe(held_s, feedback="odometry")
    ctx.measure("held", held_s)
'''


@pytest.fixture
def campaign(tmp_path, monkeypatch, capsys):
    """Exit code and what the terminal says; the campaign is in `o`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hold.py").write_text(SCRIPT)

    def go(*options):
        common = ("--bench", "emulated_floor", "--workers", "0", "--keep", "results", "--out", "o")
        code = main(["campaign", "hold.py", *common, *options])
        return code, capsys.readouterr().out

    return go


def test_a_fault_that_never_acted_is_not_survived(campaign, tmp_path):
    code, said = campaign("--seeds", "0:2", "--vary", "fault=none;tracker:off@500")
    assert code == 1
    assert "FAIL: hold, 4 PASS; 2 of them NOT TESTED" in said
    tree = json.loads((tmp_path / "o" / "campaign.json").read_text())
    without, never = tree["groups"]
    assert (without["tested"], without["pass_share"]) == (2, 1.0)
    assert (never["n"], never["tested"], never["pass_share"], never["measurements"]) == (2, 0, None, [])
    assert [row["verdict"] for row in tree["rows"]] == ["PASS"] * 4
    assert [row["faults_not_met"] for row in tree["rows"]] == [[], [], *[["tracker:off@500"]] * 2]
    with (tmp_path / "o" / "campaign.csv").open(newline="") as file:
        lines = [line["faults_not_met"] for line in csv.DictReader(file)]
    assert lines == ["", "", *["tracker:off@500"] * 2]
    page = (tmp_path / "o" / "campaign.html").read_text()
    assert page.count("PASS, not tested") == 2
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(tmp_path / "o" / "rows").to_pydict()
    assert table["faults_not_met"].count(["tracker:off@500"]) == 2


def test_the_share_is_that_of_the_runs_in_which_the_fault_acted_also_when_they_are_read_again(campaign):
    options = ("--seeds", "0:4", "--vary", "fault=tracker:off@1.4")
    for more in ((), ("--resume",)):
        code, said = campaign(*options, *more)
        assert (code, "4 runs, 100 % good of 2 tested (95 %" in said) == (1, True), said
        assert "2 NOT TESTED: no cycle met tracker:off@1.4 in 2" in said
        assert "[1.3 to 1.8]" in said


def test_an_untested_failure_is_not_counted_either():
    rows = [
        Row(Case(0), "0", "PASS", 0, 1.0),
        Row(Case(1), "1", "FAIL", 1, 1.0, faults_not_met=("imu:off@9",)),
        Row(Case(2), "2", "PASS", 0, 1.0, faults_not_met=("imu:off@9",)),
    ]
    (group,) = summarise(rows)
    assert (group["n"], group["tested"], group["good"], group["pass_share"]) == (3, 1, 1, 1.0)
    assert group["faults_not_met"] == {"imu:off@9": 2}


def no_room_for(monkeypatch, *seeds):
    """The disk takes no result of these seeds."""
    usual = result_files.put_whole

    def put(path, content):
        if path.parent.name in {f"seed={seed}" for seed in seeds}:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        usual(path, content)

    monkeypatch.setattr(result_files, "put_whole", put)


def test_a_run_that_left_no_result_is_lost_and_counts_as_neither_good_nor_bad(
    campaign, tmp_path, monkeypatch
):
    no_room_for(monkeypatch, 1, 3)
    code, said = campaign("--seeds", "0:4")
    assert code == 4
    assert "result.json: cannot be written (No space left on device)" in said
    tree = json.loads((tmp_path / "o" / "campaign.json").read_text())
    (group,) = tree["groups"]
    assert (group["n"], group["tested"], group["lost"], group["good"]) == (4, 2, 2, 2)
    assert group["pass_share"] == 1.0
    assert (group["measurements"][0]["of"], group["measurements"][0]["missing"]) == (2, {})
    assert (tmp_path / "o" / "campaign.html").read_text().count("LOST") > 1
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    code, said = campaign("--seeds", "0:4", "--resume")
    assert (code, "4 runs, 100 % good (95 %" in said) == (0, True), said
