"""Killed with -9 in the middle: what was recorded is readable, and the journal goes on from there."""

import json
import os
import re
import select
import signal
import subprocess
import sys
import time

import pytest

from hil.datasets.plain_csv import read_plain

SETTINGS = {
    "motions": "rotation_ccw",
    "repetitions": 2,
    "validation_repetitions": 1,
    "turns": 0.1,
    "max_rounds": 2,
    "compared_methods": "",
}
DEADLINE_S = 120.0


def command(folder, processes):
    settings = [f"--set={k}={v}" for k, v in {**SETTINGS, "processes": processes}.items()]
    run = [sys.executable, "-m", "hil.cli", "run", "odometry_calibration", "--out", str(folder), "--json"]
    return [*run, *settings]


def steps(folder):
    """Titles of the checkpoints that the journal holds."""
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    entries = [json.loads(line) for line in lines if line.endswith("}")]
    return [e["title"] for e in entries if e["kind"] == "value"]


def kill_after(folder, title, processes):
    child = subprocess.Popen(
        command(folder, processes),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        start_new_session=True,
    )
    deadline = time.monotonic() + DEADLINE_S
    while title not in steps(folder) and child.poll() is None and time.monotonic() < deadline:
        wait(0.02)
    child.send_signal(signal.SIGKILL)
    child.wait(30)
    assert child.returncode == -signal.SIGKILL
    assert title in steps(folder)
    return child.pid


def wait(seconds):
    select.select([], [], [], seconds)


def nobody_left(group):
    """Whether the workers of a killed run have ended by themselves."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        wait(0.1)
    return False


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    done = subprocess.run(command(folder, 1), capture_output=True, timeout=DEADLINE_S, text=True)
    assert done.returncode in (0, 1), done.stderr
    return done


@pytest.fixture(scope="module")
def undisturbed(whole_run):
    return json.loads(whole_run.stdout)


@pytest.mark.long
def test_progress_reports_round_recording_and_the_time_that_is_left(whole_run):
    lines = whole_run.stderr.splitlines()
    assert any(text.startswith("round 2 of 2, recording: 1/2") for text in lines)
    assert any(re.search(r", (about \d+ (s|min)|a few seconds) left in all$", text) for text in lines)
    assert any(text.startswith("validation, recording") for text in lines)


@pytest.mark.long
@pytest.mark.parametrize(("title", "processes"), [("round 1, repetition 1", 1), ("round 2, repetition 1", 2)])
def test_after_kill_9_the_run_goes_on_and_ends_the_same(tmp_path, undisturbed, title, processes):
    folder = tmp_path / "run"
    group = kill_after(folder, title, processes)
    assert nobody_left(group)
    kept = {p: p.read_bytes() for p in sorted((folder / "recordings" / "round_1").glob("*_1.csv"))}
    assert len(kept) == 1
    for path in kept:
        assert read_plain(path).t_s[-1] > 1.0
    done_before = steps(folder)
    resumed = subprocess.run(
        [*command(folder, processes), "--resume"], capture_output=True, timeout=DEADLINE_S
    )
    tree = json.loads(resumed.stdout)
    assert tree["resumed"] == 1
    assert [s["title"] for s in tree["steps"] if s["outcome"] == "resumed"] == done_before
    assert {p: p.read_bytes() for p in kept} == kept
    values = {m["name"]: m["value"] for m in tree["measurements"]}
    assert values == {m["name"]: m["value"] for m in undisturbed["measurements"]}
