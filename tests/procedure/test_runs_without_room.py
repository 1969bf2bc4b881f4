"""`hil run` on a full disk: the robot stops unless asked otherwise, and the verdict is never lost."""

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.run import command
from hil.core.errors import RecordingError
from hil.procedure import Measurement, procedure
from hil.procedure.bench_source import BenchSource
from hil.procedure.run_journal import Journal, read_journal
from hil.recording.mcap_reader import read_cycles
from hil.robot.trajectories import line

FULL = Path("/dev/full")

pytestmark = [
    pytest.mark.timeout(900),  # the first process to start may compile the estimators
    pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full"),
]


@procedure(name="ahead", measurements=(Measurement("x", "m", low=0.03),))
def ahead(ctx):
    """Drives 0.05 m."""
    with ctx.step("drive"):
        motion = ctx.bench.drive(line((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), duration_s=2.0), hold_s=0.2)
    with ctx.step("look"):
        ctx.measure("x", float(motion.estimate[-1, 0]))


@procedure(name="bare", measurements=(Measurement("good", "1", low=0.0),))
def bare(ctx):
    """Needs no bench."""
    with ctx.step("one"):
        ctx.measure("good", 1.0)


def tree_of(result):
    return json.loads((result.folder / "result.json").read_text())


def test_a_run_that_is_no_longer_recorded_is_aborted(run_small, full_disk):
    full_disk(150_000)
    result = run_small(ahead, source=BenchSource("emulated_floor", seed=4))
    tree = tree_of(result)
    assert (tree["verdict"], result.exit_code) == ("ABORTED", 4)
    assert (tree["error"]["type"], tree["error"]["step"]) == ("RecordingError", "drive")
    assert "recording.mcap: recording failed" in tree["error"]["message"]
    assert "No space left on device" in tree["error"]["message"]
    assert any("recording.mcap is not complete" in note for note in tree["notes"])
    assert len(list(read_cycles(result.folder / "recording.mcap", []))) > 50


def test_the_operator_may_have_it_go_on(run_small, full_disk):
    full_disk(150_000)
    result = run_small(ahead, source=BenchSource("emulated_floor", seed=4), on_recording_failure="go-on")
    tree = tree_of(result)
    assert (tree["verdict"], result.exit_code) == ("PASS", 0)
    assert any("recording.mcap is not complete" in note for note in tree["notes"])


def test_what_is_lost_at_the_very_end_counts_too(run_small, monkeypatch):
    """The disk takes all cycles and fails when the recording is closed: measured, but not recorded."""
    from hil.recording.mcap_file import RecordingFile

    def finish(file):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(RecordingFile, "finish", finish)
    result = run_small(ahead, source=BenchSource("emulated_floor", seed=4))
    assert result.exit_code == 4
    assert "No space left" in tree_of(result)["error"]["message"]


def test_a_recording_that_cannot_begin_ends_the_run_or_not(run_small, tmp_path):
    for policy, code in (("stop", 2), ("go-on", 0)):
        folder = tmp_path / policy
        folder.mkdir()
        (folder / "recording.mcap").symlink_to(folder / "nowhere" / "recording.mcap")
        source = BenchSource("emulated_floor", seed=4)
        result = run_small(ahead, folder, source=source, on_recording_failure=policy)
        assert result.exit_code == code
        tree = tree_of(result)
        said = " ".join([*tree["notes"], str(tree["error"])])
        assert "recording.mcap: cannot be written" in said


@pytest.mark.parametrize(
    ("error", "said"), [(OSError("the share is gone"), "the share is gone"), (OSError(), "OSError")]
)
def test_a_refusal_without_a_text_of_the_system_is_reported_all_the_same(tmp_path, monkeypatch, error, said):
    def refused(*_):
        raise error

    journal = Journal(tmp_path / "journal.jsonl")
    monkeypatch.setattr("hil.procedure.run_journal.os.write", refused)
    with pytest.raises(RecordingError, match=rf"cannot be written \({said}\)"):
        journal.add("run", {"schema": 1})
    journal.close()


def test_a_journal_that_is_full_stops_the_run_and_can_be_resumed(run_small, tmp_path, monkeypatch):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.add("run", {"schema": 1})
    write = os.write

    def half(fd, data):
        if len(data) < 20:
            raise OSError(28, os.strerror(28))
        return write(fd, data[:12])

    with monkeypatch.context() as patch:
        patch.setattr("hil.procedure.run_journal.os.write", half)
        with pytest.raises(
            RecordingError, match=r"journal\.jsonl: cannot be written \(No space left"
        ) as error:
            journal.add("note", {"text": "x" * 10})
    assert error.value.exit_code == 4
    journal.add("note", {"text": "again"})
    journal.close()
    assert [json.loads(e)["kind"] for e in path.read_text().splitlines()] == ["run", "note"]
    assert read_journal(path).header["schema"] == 1


def test_a_run_may_go_on_without_its_journal(run_small, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("hil.procedure.runner._past", lambda *anything: None)
    for policy in ("go-on", "stop"):
        (tmp_path / policy).mkdir()
        (tmp_path / policy / "journal.jsonl").symlink_to(FULL)
    assert run_small(bare, tmp_path / "go-on", on_recording_failure="go-on").exit_code == 0
    assert sum("goes on without it" in r.getMessage() for r in caplog.records) == 1
    with pytest.raises(RecordingError, match="cannot be written"):
        run_small(bare, tmp_path / "stop")


def test_a_result_that_cannot_be_written_is_reported_and_not_passed(run_small, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "result.json.part").symlink_to(FULL)
    result = run_small(bare, folder)
    assert (result.verdict.value, result.exit_code) == ("ERROR", 4)
    (lost,) = result.teardown_errors
    assert "result.json: cannot be written (No space left on device)" in lost.message
    assert [m["outcome"] for m in result.measurements] == ["PASS"]
    assert not (folder / "result.json").exists()
    assert not (folder / "result.json.part").is_symlink()


SCRIPT = """
from hil.procedure import Measurement, procedure

@procedure(name="bare", measurements=(Measurement("good", "1", low=0.0),))
def bare(ctx):
    "Needs no bench."
    with ctx.step("one"):
        ctx.measure("good", 1.0)
"""


@pytest.mark.parametrize(
    ("file", "code", "named"),
    [
        ("result.json.part", 4, "result.json: cannot be written"),
        ("report.html", 2, "report.html: cannot be written"),
    ],
)
def test_the_command_prints_the_verdict_whatever_the_disk_does(tmp_path, file, code, named):
    script, folder = tmp_path / "bare.py", tmp_path / "run"
    script.write_text(SCRIPT)
    for as_json in (True, False):
        folder = tmp_path / f"run{as_json}"
        folder.mkdir()
        (folder / file).symlink_to(FULL)
        options = ["--out", str(folder), *(["--json"] if as_json else [])]
        done = CliRunner().invoke(command, [str(script), *options], standalone_mode=False)
        assert done.return_value == code, done.output
        assert named in done.output
        if as_json:
            tree = json.loads(done.stdout)
            assert (tree["measurements"][0]["outcome"], tree["report"]) == ("PASS", None)
        else:
            assert "good" in done.stdout
            assert "report: could not be written" in done.stdout


def test_a_figure_that_finds_no_room_aborts_the_run(run_small):
    @procedure(name="drawing")
    def drawing(ctx):
        FULL.write_text("figure")

    result = run_small(drawing)
    assert (result.verdict.value, result.exit_code) == ("ABORTED", 4)
    assert "No space left on device" in result.error.message
