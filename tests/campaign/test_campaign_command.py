"""`hil campaign` over a procedure of a user's own."""

import csv
import errno
import json
import logging
import os
import re
import signal
import subprocess
import sys
import time
from importlib import resources
from urllib.parse import quote

import pytest

from hil.cli import main
from tests.selected import every

SCRIPT = '''
"""A procedure of a moment."""
import os
import signal
from dataclasses import dataclass

import numpy as np

from hil.procedure import Context, Measurement, procedure


@dataclass
class Parameters:
    gain: float = 1.0
    deadly: int = -1
    asks: int = -1


@procedure(
    name="rest", needs=("mocap",), parameters=Parameters,
    measurements=[
        Measurement("drift", "mm", high=20.0, rationale="it holds itself"),
        Measurement("gained", "1", high=5.0, rationale="gain times seed"),
    ],
)
def run(ctx: Context) -> None:
    """Hold for a moment."""
    if ctx.seed == ctx.parameters.deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    if ctx.seed == ctx.parameters.asks:
        ctx.prompt("is the robot on the wall?")
    with ctx.step("rest"):
        ctx.bench.devices.servos.enable()
        seen = ctx.bench.observe(0.3, feedback="odometry").mocap[:, 0]
    ctx.measure("drift", 1e3 * float(np.nanmax(seen) - np.nanmin(seen)))
    ctx.measure("gained", ctx.parameters.gain * ctx.seed)
'''


@pytest.fixture
def script(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rest.py"
    path.write_text(SCRIPT)
    return path.name


@pytest.fixture
def campaign(script, capsys):
    """Exit code, JSON and stderr of a campaign; in this process and without recordings, unless asked."""
    usual = {"--bench": "emulated_floor", "--keep": "results", "--workers": "0"}

    def go(*options):
        missing = usual.keys() - {*options, "--workers" if "--scheduler" in options else ""}
        more = [word for name in missing for word in (name, usual[name])]
        code = main(["campaign", script, *more, *options, "--json"])
        said = capsys.readouterr()
        return code, json.loads(said.out) if said.out else None, said.err

    return go


def test_results_alone_are_the_same_without_recordings_and_figures(campaign, tmp_path):
    rows = {}
    for keep in ("all", "results"):
        words = ("--bench", "emulated", "--seeds", "3", "--keep", keep, "--out", keep)
        code, tree, _ = campaign(*words)
        assert code == 0
        rows[keep] = tree["rows"][0]
    assert rows["all"]["measurements"] == rows["results"]["measurements"]
    assert "--keep" not in rows["results"]["command"]
    left = {k: {p.suffix for p in (tmp_path / k).rglob("*") if p.is_file()} for k in rows}
    assert left["all"] - left["results"] == {".mcap", ".svg"}
    reported = json.loads((tmp_path / "results/runs/seed=3/result.json").read_text())
    assert reported["recordings"] == []


def test_runs_table_and_page(campaign, tmp_path):
    code, tree, _ = campaign("--seeds", "0:3", "--vary", "gain=1,3", "--out", "o")
    assert (code, tree["verdict"], tree["verdicts"]) == (1, "FAIL", {"FAIL": 1, "PASS": 5})
    assert [(g["settings"], g["pass_share"]) for g in tree["groups"]] == [
        ({"gain": "1"}, 1.0),
        ({"gain": "3"}, 2 / 3),
    ]
    gained = {row["case"]: row["measurements"]["gained"]["value"] for row in tree["rows"]}
    assert gained["seed=2_gain=3"] == 6.0
    drifts = {row["seed"]: row["measurements"]["drift"]["value"] for row in tree["rows"]}
    assert len(set(drifts.values())) == 3
    assert json.loads((tmp_path / "o" / "campaign.json").read_text()) == tree
    with (tmp_path / "o" / "campaign.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["verdict"] for line in lines] == [row["verdict"] for row in tree["rows"]]
    page = (tmp_path / "o" / "campaign.html").read_text()
    assert page.count("<img") == 2
    for row in tree["rows"]:
        assert f'href="runs/{quote(row["case"])}/report.html"' in page
        assert (tmp_path / "o" / "runs" / row["case"] / "report.html").exists()


def test_it_goes_on_where_it_was_and_may_grow(campaign, tmp_path):
    campaign("--seeds", "0:2", "--out", "o")
    runs = tmp_path / "o" / "runs"
    (runs / "seed=1" / "result.json").unlink()
    journal = runs / "seed=1" / "journal.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:2]) + '{"kind": "st')
    untouched = (runs / "seed=0" / "result.json").stat().st_mtime_ns
    code, tree, _ = campaign("--seeds", "0:3", "--keep", "all", "--out", "o", "--resume")
    assert (code, [row["verdict"] for row in tree["rows"]]) == (0, ["PASS"] * 3)
    assert (runs / "seed=0" / "result.json").stat().st_mtime_ns == untouched
    assert json.loads((runs / "seed=1" / "result.json").read_text())["resumed"] == 1
    assert {p.parent.name for p in runs.rglob("*.mcap")} == {"seed=1", "seed=2"}  # this time they are kept


def no_verdict(run):
    """A run that was killed as it began."""
    (run / "result.json").unlink()
    (run / "journal.jsonl").write_text("")


def torn_result(run):
    text = (run / "result.json").read_text()
    (run / "result.json").write_text(text[: len(text) // 2])


def no_journal(run):
    (run / "result.json").unlink()
    (run / "journal.jsonl").unlink()


def test_runs_that_cannot_go_on_are_put_aside_and_begin_anew(campaign, tmp_path):
    options = ("--seeds", "0:4", "--out", "o")
    _, before, _ = campaign(*options)
    left = {}
    for seed, damage in enumerate((no_verdict, torn_result, no_journal), start=1):
        run = tmp_path / "o" / "runs" / f"seed={seed}"
        damage(run)
        left[f"{run.name}.damaged-1"] = {p.name: p.read_bytes() for p in run.iterdir()}
    for _ in range(2):
        code, tree, _ = campaign(*options, "--resume")
        assert (code, tree["verdicts"]) == (0, {"PASS": 4})
    assert [r["measurements"] for r in tree["rows"]] == [r["measurements"] for r in before["rows"]]
    aside = (tmp_path / "o" / "runs").glob("*damaged*")
    assert {run.name: {p.name: p.read_bytes() for p in run.iterdir()} for run in aside} == left


def test_a_run_that_lacked_room_is_run_again(campaign, tmp_path):
    campaign("--seeds", "0", "--out", "o")
    result = tmp_path / "o" / "runs" / "seed=0" / "result.json"
    tree = json.loads(result.read_text())
    error = {"type": "RecordingError", "step": "rest", "message": "x.mcap: cannot be written"}
    result.write_text(json.dumps({**tree, "verdict": "ERROR", "exit_code": 4, "error": error}))
    code, tree, _ = campaign("--seeds", "0", "--out", "o", "--resume")
    assert (code, tree["verdicts"]) == (0, {"PASS": 1})


def test_who_resumes_with_files_that_have_changed_is_refused_with_their_names(campaign, tmp_path):
    profile = resources.files("hil.config.profiles").joinpath("emulated_floor.toml").read_text()
    (tmp_path / "bench.toml").write_text(profile)
    options = ("--bench", "bench.toml", "--out", "o", "--vary", "fault=none")
    assert campaign("--seeds", "0", *options)[0] == 0
    for name in ("rest.py", "bench.toml"):
        file = tmp_path / name
        before = file.read_text()
        file.write_text(before + "\n# changed\n")
        code, _, said = campaign("--seeds", "0:2", *options, "--resume")
        assert (code, f"{file} changed since the campaign began" in said) == (2, True), said
        file.write_text(before)
    (tmp_path / "late.toml").write_text('[[fault]]\ndevice = "tracker"\nkind = "slow"\nat_s = 0.1\n')
    options, more = options[:-1], ("fault=none,late.toml", "--resume")
    assert campaign("--seeds", "0:2", *options, *more)[0] == 0
    (tmp_path / "late.toml").write_text('[[fault]]\ndevice = "tracker"\nkind = "slow"\nat_s = 0.2\n')
    assert campaign("--seeds", "0:2", *options, *more)[0] == 2


def test_rows_that_are_missing_or_torn_are_written_when_it_goes_on(campaign, tmp_path):
    pytest.importorskip("pyarrow")
    campaign("--seeds", "0:3", "--out", "o")
    rows = sorted((tmp_path / "o" / "rows").glob("*.parquet"))
    whole = [row.read_bytes() for row in rows]
    rows[0].unlink()
    rows[1].write_bytes(whole[1][:-3])
    campaign("--seeds", "0:3", "--out", "o", "--resume")
    assert [row.read_bytes() for row in rows] == whole


def test_a_full_disk_ends_it_with_what_to_do(campaign, monkeypatch):
    pytest.importorskip("pyarrow")

    def full(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("hil.campaign.parquet_rows.put_whole", full)
        code, _, said = campaign("--seeds", "0:2", "--out", "o")
    assert code == 4
    assert "rows: cannot be written (No space left on device); make room, then go on with --resume" in said
    assert campaign("--seeds", "0:2", "--out", "o", "--resume")[0] == 0


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (("--vary", "speed=1,2"), "speed: unknown parameter"),
        (("--vary", "fault=none;mocap:bus_off"), "mocap cannot produce the fault 'bus_off'"),
        (("--vary", "bench.colour=red"), "colour: unknown key"),
        (("--bench", "sensors"), "needs mocap, which the bench 'sensors' lacks"),
        (("--resume",), "there is no campaign to resume"),
        (("--set", "bench.mocap.backend=real"), "mocap cannot be real in a campaign"),
        (("--set", "gain=1", "--vary", "gain=1,2"), "gain is both given by --set and varied by --vary"),
        (("--vary", "gain=1,2,1e0"), "gain=1 and gain=1e0 are the same setting; name each value once"),
        (("--answers", "absent.txt"), "absent.txt"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_runs(campaign, tmp_path, options, reported):
    code, tree, said = campaign("--out", "o", *options)
    assert (code, tree["error"]["exit_code"]) == (2, 2)
    assert reported in said
    assert not (tmp_path / "o").exists()


def test_another_campaign_is_not_written_over_nor_runs_whose_plan_is_lost(campaign, tmp_path):
    assert campaign("--seeds", "0", "--out", "o")[0] == 0
    code, _, said = campaign("--seeds", "0", "--out", "o")
    assert (code, "holds a campaign" in said) == (2, True)
    code, _, said = campaign("--seeds", "0", "--out", "o", "--resume", "--set", "gain=2")
    assert (code, "differs in settings" in said) == (2, True)
    (tmp_path / "o" / "plan.json").unlink()
    code, _, said = campaign("--seeds", "0", "--set", "gain=2", "--out", "o")
    assert (code, "holds a campaign" in said) == (2, True)
    code, _, said = campaign("--seeds", "0", "--out", "o", "--resume")
    assert (code, "no campaign to resume" in said) == (2, True)


def test_a_plan_of_which_nothing_ran_is_no_campaign(campaign, tmp_path):
    """A scheduler that does not answer, or Ctrl-C while workers start, leave one."""
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "plan.json").write_text("{}")
    assert campaign("--seeds", "0", "--out", "o")[0] == 0


@pytest.mark.usefixtures("warm_commands")
@pytest.mark.parametrize(
    ("name", "how"), every(2, [("SIGINT", "interrupted"), ("SIGHUP", "ended by SIGHUP")])
)
def test_a_terminal_ends_the_workers_says_what_is_finished_and_shows_nothing_of_dask(
    script, campaign, tmp_path, name, how
):
    """What Dask's workers have finished is what one process gives."""
    pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")
    words = ("--workers", "1", "--seeds", "0:400", "--keep", "results", "--out", "o")
    command = [sys.executable, "-m", "hil", "campaign", script, "--bench", "emulated_floor", *words]
    process = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while len(list((tmp_path / "o").rglob("result.json"))) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, getattr(signal, name))
    said = process.communicate(timeout=600)[1]
    assert process.returncode == 4
    assert "Traceback" not in said
    assert re.search(rf"the campaign was {how}; [1-9]\d* of 400 runs are finished", said)
    assert "--resume" in said
    finished = int(re.search(r"(\d+) of 400 runs are finished\)", said)[1])
    tree = json.loads((tmp_path / "o" / "campaign.json").read_text())
    assert (tree["verdict"], tree["exit_code"]) == ("ABORTED", 4)
    assert (tree["cases"], tree["planned"]) == (finished, 400)
    assert len(tree["rows"]) == finished
    assert f"{finished} of 400 runs are finished" in (tmp_path / "o" / "campaign.html").read_text()
    with (tmp_path / "o" / "campaign.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == finished
    alone = campaign("--seeds", str(tree["rows"][0]["seed"]), "--out", "alone")[1]
    assert alone["rows"][0]["measurements"] == tree["rows"][0]["measurements"]


def test_an_error_in_one_run_is_a_row(campaign):
    options = ("--seeds", "1", "--vary", "fault=none;servos:off")
    code, tree, _ = campaign(*options, "--out", "o")
    assert code == 3
    assert [row["verdict"] for row in tree["rows"]] == ["PASS", "ERROR"]
    assert "servos" in tree["rows"][1]["error"]


def test_a_warning_of_a_run_names_its_case(tmp_path, monkeypatch, caplog, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "warns.py").write_text(
        "import logging\nfrom hil.procedure import procedure\n\n@procedure(name='warns')\n"
        "def run(ctx):\n    logging.getLogger('hil.x').warning('%s has started again', 'tracker')\n"
    )
    assert main(["campaign", "warns.py", "--seeds", "0:2", "--workers", "0", "--out", "o"]) == 0
    logging.getLogger("hil.x").warning("after it")
    assert caplog.messages == [
        "seed=0: tracker has started again",
        "seed=1: tracker has started again",
        "after it",
    ]


def test_a_run_that_is_aborted_ends_the_campaign_until_it_is_resumed(campaign, tmp_path):
    common = ("--seeds", "0:3", "--set", "asks=1", "--out", "o")
    code, tree, said = campaign(*common)
    assert (code, tree["error"]["exit_code"]) == (4, 4)
    assert "there is no operator to answer" in said
    assert not (tmp_path / "o" / "runs" / "seed=2").exists()
    (tmp_path / "answers.txt").write_text("yes\n")
    code, tree, _ = campaign(*common, "--resume", "--answers", "answers.txt")
    assert (code, tree["verdicts"]) == (0, {"PASS": 3})


@pytest.mark.long
def test_a_run_that_kills_its_worker_is_lost_alone(campaign):
    pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")
    code, tree, _ = campaign("--seeds", "0:3", "--set", "deadly=1", "--workers", "2", "--out", "o")
    assert code == 4
    assert [row["verdict"] for row in tree["rows"]] == ["PASS", "LOST", "PASS"]
    assert "its worker process died" in tree["rows"][1]["error"]


def test_without_dask_it_says_what_to_install(campaign, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    code, tree, said = campaign("--seeds", "0:2", "--workers", "2", "--out", "o")
    assert (code, list(tree)) == (2, ["error"])
    assert "-m pip install 'dask[distributed]" in said


def test_without_dask_nobody_has_to_ask_for_one_process(script, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    options = ("--bench", "emulated_floor", "--keep", "results", "--seeds", "0:2", "--out", "o")
    assert main(["campaign", script, *options]) == 0
    assert capsys.readouterr().err.count("Dask is not installed") == 1


def test_a_scheduler_that_does_not_answer(campaign):
    pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")
    code, _, said = campaign("--seeds", "0", "--scheduler", "nonsense://1", "--out", "o")
    assert code == 2
    assert "Dask scheduler 'nonsense://1' does not answer" in said
