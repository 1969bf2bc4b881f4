"""A run that was killed goes on where it was; a journal that cannot be trusted is refused by name."""

import json
import signal
import subprocess
import sys

import pytest

from hil.cli import main
from hil.core.errors import ConfigError, UsageError
from hil.procedure import Measurement, procedure
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.run_journal import Journal, read_journal

DONE = []


def work(ctx, title, fatal=""):
    def function():
        DONE.append(title)
        ctx.measure(title, float(len(title)))
        ctx.table(title, ["a"], [[1]])
        if title == fatal:
            raise KeyboardInterrupt
        return {"title": title, "pair": (1, 2)}

    return ctx.checkpoint(title, function)


MEASURED = tuple(Measurement(n, "1", high=10) for n in ("alpha", "beta", "gamma"))


def make(fatal=""):
    @procedure(name="resumable", measurements=MEASURED)
    def resumable(ctx):
        for title in ("alpha", "beta", "gamma"):
            assert work(ctx, title, fatal) == {"title": title, "pair": [1, 2]}

    return resumable


@pytest.fixture(autouse=True)
def _fresh():
    DONE.clear()


def interrupted(run_small, folder):
    assert run_small(make("beta"), folder).verdict.value == "ABORTED"
    return folder


def test_a_resumed_run_takes_finished_checkpoints_from_the_journal(run_small, tmp_path):
    folder = interrupted(run_small, tmp_path / "r")
    assert DONE == ["alpha", "beta"]
    result = run_small(make(), folder, resume=True)
    assert DONE == ["alpha", "beta", "beta", "gamma"]
    tree = json.loads((folder / "result.json").read_text())
    assert (result.verdict.value, tree["resumed"]) == ("PASS", 1)
    assert [m["value"] for m in tree["measurements"]] == [5.0, 4.0, 5.0]
    assert [t["title"] for t in tree["tables"]] == ["alpha", "beta", "gamma"]
    assert [s["outcome"] for s in tree["steps"]] == ["resumed", "done", "done"]


def test_a_finished_run_cannot_be_resumed(run_small, tmp_path):
    run_small(make(), tmp_path / "r")
    with pytest.raises(ConfigError, match="finished"):
        run_small(make(), tmp_path / "r", resume=True)


@pytest.mark.parametrize("length", [1, 20, 39])
def test_a_line_cut_off_by_a_kill_is_dropped(run_small, tmp_path, length):
    folder = interrupted(run_small, tmp_path / "r")
    path = folder / "journal.jsonl"
    path.write_bytes(path.read_bytes() + b'{"kind": "measure", "name": "alpha", "value": 99.0}'[:length])
    assert run_small(make(), folder, resume=True).exit_code == 0
    for line in path.read_text().splitlines():
        json.loads(line)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda lines: ["", *lines[1:]], "line 1"),
        (lambda lines: [lines[0], "not json", *lines[1:]], "line 2 is damaged"),
        (lambda lines: [lines[0], '{"kind": "dance"}', *lines[1:]], "line 2 is damaged"),
        (lambda lines: [lines[0], '{"kind": "value"}', *lines[1:]], "line 2 lacks"),
        (lambda lines: [lines[0].replace('"schema": 1', '"schema": 9'), *lines[1:]], "schema 9"),
        (lambda lines: [lines[0].replace('"seed": 0', '"seed": 5'), *lines[1:]], "differs in seed"),
        (lambda lines: [], "does not start a run"),
    ],
)
def test_a_broken_journal_is_named_and_nothing_runs(run_small, tmp_path, damage, words):
    folder = interrupted(run_small, tmp_path / "r")
    path = folder / "journal.jsonl"
    path.write_text("".join(f"{line}\n" for line in damage(path.read_text().splitlines())))
    before = path.read_bytes()
    DONE.clear()
    with pytest.raises(ConfigError, match=words) as caught:
        run_small(make(), folder, resume=True)
    assert "journal.jsonl" in str(caught.value)
    assert caught.value.exit_code == 2
    assert DONE == []
    assert path.read_bytes() == before


def test_a_run_that_is_at_work_is_neither_resumed_nor_run_beside(run_small, tmp_path):
    folder, said = tmp_path / "r", []

    @procedure(name="resumable", measurements=MEASURED)
    def at_work(ctx):
        before = (folder / "journal.jsonl").read_bytes()
        for resume in (True, False):
            try:
                run_small(make(), folder, resume=resume)
            except UsageError as error:
                said.append(str(error))
        assert (folder / "journal.jsonl").read_bytes() == before

    assert run_small(at_work, folder).error is None
    assert DONE == []
    assert [f"{folder}: a run is at work there" in text for text in said] == [True, True]


def test_nothing_to_resume_is_said(run_small, tmp_path):
    with pytest.raises(ConfigError, match="no journal"):
        run_small(make(), tmp_path / "absent", resume=True)


def test_a_checkpoint_title_is_used_once_and_its_result_is_json(run_small):
    @procedure(name="twice")
    def twice(ctx):
        ctx.checkpoint("same", lambda: 1)
        ctx.checkpoint("same", lambda: 1)

    @procedure(name="opaque")
    def opaque(ctx):
        ctx.checkpoint("one", object)

    assert "exists twice" in run_small(twice).error.message
    assert "JSON" in run_small(opaque).error.message


def test_every_entry_is_on_disk_when_add_returns(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("run", {"schema": 1})
    journal.add("step", {"title": "a"})
    assert len((tmp_path / "journal.jsonl").read_text().splitlines()) == 2
    assert read_journal(tmp_path / "journal.jsonl").header["schema"] == 1
    journal.close()
    journal.close()


SCRIPT = """
import os, signal
from hil.procedure import Measurement, procedure

@procedure(name="killed", measurements=(Measurement("a", "1"), Measurement("b", "1")))
def run(ctx):
    def first():
        ctx.measure("a", 1.0)
        return os.getpid()
    pid = ctx.checkpoint("first", first)
    with ctx.step("second"):
        if pid == os.getpid():
            os.kill(pid, signal.SIGKILL)
        ctx.measure("b", 2.0)
"""


def test_after_kill_9_the_command_line_resumes(tmp_path, capsys, warm_commands):
    script = tmp_path / "killed.py"
    script.write_text(SCRIPT)
    words = ["run", str(script), "--bench", "sensors", "--out", str(tmp_path / "out"), "--json"]
    first = subprocess.run([sys.executable, "-m", "hil.cli", *words], capture_output=True, timeout=600)
    assert first.returncode == -signal.SIGKILL
    (tmp_path / "out" / "recording.mcap").touch()
    assert main(["report", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'out'}: is of a run that was killed" in said
    assert f"--out {tmp_path / 'out'} --resume" in said
    assert f"hil replay {tmp_path / 'out' / 'recording.mcap'}" in said
    (tmp_path / "out" / "recording.mcap").unlink()
    assert main([*words, "--resume"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["verdict"] == "PASS"
    assert [m["value"] for m in tree["measurements"]] == [1.0, 2.0]


def test_another_bench_is_named_by_its_key(run_small, tmp_path, bare_source):
    folder = interrupted(run_small, tmp_path / "r")
    other = bare_source.changed(overrides={"environment.tilt_rad": 1.2, "loop.rate_hz": 50.0})
    with pytest.raises(ConfigError, match=r"differs in bench\.environment\.tilt_rad, bench\.loop\.rate_hz;"):
        run_small(make(), folder, resume=True, source=other)
    assert run_small(make(), folder, resume=True).verdict.value == "PASS"


LIMITED = """
from hil.procedure import Measurement, procedure

@procedure(name="limited", measurements=(Measurement("a", "mm", high=0.9), Measurement("b", "1")))
def run(ctx):
    ctx.measure("a", ctx.checkpoint("one", lambda: 0.5))
    ctx.measure("b", 1)
    if not (ctx.folder / "go").exists():
        raise RuntimeError("first time")
"""


def limited(tmp_path, text):
    path = tmp_path / "limited.py"
    path.write_text(text)
    return load_procedure(str(path))


def test_an_edited_script_does_not_go_on_with_what_the_old_one_finished(run_small, tmp_path):
    folder = tmp_path / "r"
    assert run_small(limited(tmp_path, LIMITED), folder).verdict.value == "ERROR"
    (folder / "go").touch()
    edited = (
        LIMITED.replace("0.9", "60")
        .replace('Measurement("b", "1")', 'Measurement("c", "1")')
        .replace("lambda: 0.5", "lambda: 55.0")
    )
    before = (folder / "journal.jsonl").read_bytes()
    with pytest.raises(ConfigError) as caught:
        run_small(limited(tmp_path, edited), folder, resume=True)
    for said in ("limited.py", "a (high 0.9, now 60.0)", "measurement b (", "measurement c (new)"):
        assert said in str(caught.value)
    assert caught.value.exit_code == 2
    assert (folder / "journal.jsonl").read_bytes() == before
    assert run_small(limited(tmp_path, LIMITED), folder, resume=True).verdict.value == "PASS"


@pytest.mark.parametrize("damage", [{"measurements": [{}]}, {"script": "x"}])
def test_a_damaged_header_is_refused(run_small, tmp_path, damage):
    folder = interrupted(run_small, tmp_path / "r")
    journal = folder / "journal.jsonl"
    first, *rest = journal.read_text().splitlines(keepends=True)
    journal.write_text(json.dumps(json.loads(first) | damage) + "\n" + "".join(rest))
    with pytest.raises(ConfigError, match=f"differs in (the )?{next(iter(damage))}"):
        run_small(make(), folder, resume=True)
