"""Killed with -9 in the middle: what was recorded is readable, and the journal goes on from there."""

import json
import os
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


@pytest.mark.long
def test_after_kill_9_the_run_goes_on_and_ends_the_same(tmp_path):
    """Of a run in one process every step is struck in test_every_procedure_stops."""
    whole = subprocess.run(command(tmp_path / "whole", 1), capture_output=True, timeout=DEADLINE_S)
    undisturbed, folder, processes = json.loads(whole.stdout), tmp_path / "run", 2
    group = kill_after(folder, "round 2, repetition 1", processes)
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
