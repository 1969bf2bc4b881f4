"""What `hil results delete` takes: all that `hil` has written into a result's folder, and nothing else."""

import json
import shutil

import pytest

from hil.cli import main
from hil.config.bench import BenchConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.procedure import BenchSource, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.history.index import find_results
from hil.report.history.query import named
from hil.report.history.removal import delete, loss
from hil.report.run_page import write_run_page

SMALL = '''
"""Drives a little, and leaves everything that a run can leave."""
from matplotlib.figure import Figure

from hil.procedure import Measurement, procedure
from hil.robot.trajectories import line


@procedure(name="small", needs=("servos",), measurements=(Measurement("one", "1"),))
def run(ctx):
    """Drive 5 mm."""
    with ctx.step("a drive"):
        ctx.bench.drive(line((0, 0, 0), (0.005, 0, 0), duration_s=0.5), feedback="odometry")
        ctx.measure("one", 1.0)
    ctx.figure(Figure, "Nothing to see")
    own = ctx.folder / "own.txt"
    own.write_text("mine")
    ctx.attach("a text", own)
'''
MINE = {
    "thesis.txt": "years",
    "photos/a.jpg": "light",
    "photos/b.jpg": "light",
    "figures/mine.svg": "<svg/>",
    "attachments/letter.txt": "dear",
    "recordings/round_1/mine.csv": "1",
    "calibration.toml": "mine = 1",
}


@procedure(name="gap", measurements=())
def gap(ctx):
    """Attach a file of elsewhere."""
    write_fragment(ctx, {"robot": {"mass_kg": 1.0}}, "As weighed.")
    ctx.attach("from elsewhere", ctx.folder.parent / "given.txt")


def run(folder):
    folder.parent.mkdir(parents=True, exist_ok=True)
    (folder.parent / "given.txt").write_text("given")
    source = BenchSource(BenchConfig(schema=1, name="lab"))
    run_procedure(gap, source, RunOptions(folder, MonotonicClock(), "2026-03-01T10:00:00+00:00", {}))
    write_run_page(folder)


def put(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def files_of(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def removed(root, name):
    lost = loss(root, named(find_results(root), name, whole=True))
    delete([lost])
    return lost


@pytest.fixture
def root(tmp_path):
    run(tmp_path / "out" / "gap" / "one")
    return tmp_path / "out"


def test_of_a_run_nothing_is_left(root):
    assert removed(root, "gap/one").stays == ()
    assert files_of(root) == {"gap/given.txt"}
    assert not (root / "gap" / "one").exists()


def test_what_a_user_has_put_there_stays_and_is_named(root):
    put(root / "gap" / "one", MINE)
    lost = removed(root, "gap/one")
    assert files_of(root / "gap" / "one") == set(MINE) == set(lost.stays)
    assert "7 files that are not part of it stay in " in lost.in_words()
    assert "attachments/letter.txt, calibration.toml, figures/mine.svg" in lost.in_words()
    assert "with bench_fragment.toml;" in lost.in_words()  # the calibration is none of this run


def test_a_run_that_lies_below_stays_and_is_found_by_itself_then(root):
    one = root / "gap" / "one"
    run(one / "again")
    put(one, {"other/result.json": '{"schema": 9}'})
    tree = json.loads((one / "result.json").read_text())
    tree["attachments"].append({"name": "not its own", "path": "again/result.json"})
    (one / "result.json").write_text(json.dumps(tree))
    before = files_of(one / "again")
    removed(root, "gap/one")
    assert files_of(one / "again") == before
    kinds = {k.name: k.kind for k in find_results(root)}
    assert kinds == {"gap/one/again": "run", "gap/one/other": "foreign"}


def test_what_is_named_elsewhere_or_behind_a_link_stays(root, tmp_path):
    one, far = root / "gap" / "one", tmp_path / "far"
    put(far, {"secret.txt": "keep", "01_a.svg": "keep"})
    (one / "figures").symlink_to(far)
    (one / "compare.html").symlink_to(far / "secret.txt")
    tree = json.loads((one / "result.json").read_text())
    named_there = ["../given.txt", str(far / "secret.txt"), "figures/secret.txt", "../../../far/secret.txt"]
    tree["recordings"] = named_there
    (one / "result.json").write_text(json.dumps(tree))
    assert removed(root, "gap/one").stays == ("compare.html", "figures")
    assert files_of(far) == {"secret.txt", "01_a.svg"}
    assert (root / "gap" / "given.txt").exists()
    assert (one / "figures").is_symlink()


def test_what_was_struck_down_goes_by_its_journal(root):
    one = root / "gap" / "one"
    for name in ("result.json", "junit.xml", "report.html"):
        (one / name).unlink()
    with (one / "journal.jsonl").open("a") as journal:
        journal.write('{"kind": "attach", "path": 3}\n{"kind": "note", "path": "mine.txt"}\n{"path": torn')
    put(one, {"mine.txt": "", "result.json.part": "{", "recording_a-2.mcap": ""})
    assert removed(root, "gap/one").stays == ("mine.txt",)


def test_a_deletion_that_was_broken_off_can_be_begun_again(root):
    lost = loss(root, named(find_results(root), "gap/one"))
    (root / "gap" / "one" / "bench_fragment.toml").unlink()
    (root / "gap" / "one" / "bench_fragment.toml").mkdir()
    with pytest.raises(DataError, match=r"bench_fragment\.toml: cannot be deleted"):
        delete([lost])
    assert named(find_results(root), "gap/one").kind == "run"


@pytest.fixture
def hil(tmp_path, monkeypatch, capsys):
    """`hil` in a folder of its own; what it prints."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.py").write_text(SMALL)

    def call(*words, code=0):
        capsys.readouterr()
        assert main(list(words)) == code, capsys.readouterr().err
        return capsys.readouterr().out

    return call


def test_a_commissioning_goes_with_its_procedures_and_its_record_and_nothing_else(root):
    whole = root / "whole"
    own = (
        "commission.html",
        "trends.html",
        "ablation.svg",
        "robot/record.toml",
        "robot/history/v0001.toml",
        "robot/files/calibration-0123456789ab.toml",
        "robot/record.toml.part",
    )
    mine = {
        "thesis.txt": "years",
        "robot/notes.txt": "mind the cable",
        "01_gap/letter.txt": "dear",
        "robot/files/mine.toml": "a = 1",
        "2_gap/journal.txt": "b",
    }
    run(whole / "01_gap")
    run(whole / "01_gap-2")
    put(whole, {"commission.json": '{"options": {"bench": "lab"}, "done": {}}', **dict.fromkeys(own, "x")})
    run(whole / "a_run_of_mine")
    put(whole, mine)
    kept = files_of(whole / "a_run_of_mine")
    lost = removed(root, "whole")
    assert set(lost.stays) - {"given.txt"} == {*mine, *(f"a_run_of_mine/{name}" for name in kept)}
    assert files_of(whole) == set(lost.stays)
    assert "whole/a_run_of_mine" in {k.name for k in find_results(root)}


def test_a_campaign_goes_whole_but_for_a_notebook_and_a_run_that_is_none_of_it(hil, tmp_path):
    folder = tmp_path / "out" / "trial"
    hil("campaign", "small.py", "--seeds", "0", "--workers", "0", "--out", "out/trial")
    hil("run", "small.py", "--out", "out/mine")
    shutil.copytree(folder, tmp_path / "out" / "plain")
    shutil.copytree(tmp_path / "out" / "mine", folder / "runs" / "mine")
    put(folder, {"notebook.ipynb": "{}"})
    mine = {f"runs/mine/{name}" for name in files_of(tmp_path / "out" / "mine")}
    reported = json.loads(hil("results", "delete", "trial", "plain", "--yes", "--json"))
    assert set(reported["stays"]) == {"trial"}
    assert set(reported["stays"]["trial"]) == mine | {"notebook.ipynb"} == files_of(folder)
    assert not (tmp_path / "out" / "plain").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("run", "small.py"),
        *(
            pytest.param(words, marks=pytest.mark.long)
            for words in (
                ("run", "bring_up", "--quick"),
                ("run", "imu_calibration", "--quick"),
                ("run", "odometry_calibration", "--quick"),
                ("commission", "--quick"),
                ("accept",),
            )
        ),
    ],
)
def test_what_a_command_leaves_goes_whole(hil, tmp_path, words):
    hil(*words, "--out", "out/x")
    if words == ("run", "small.py"):
        hil("report", "out/x")
    assert "stay" not in hil("results", "delete", "x", "--yes")
    assert not (tmp_path / "out" / "x").exists()
