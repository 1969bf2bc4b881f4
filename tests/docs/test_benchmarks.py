"""Benchmarks run: altered lines are noticed, a soak explains every stop, the table of speed is printed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments):
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=1800, check=False
    )


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_what_is_altered_is_noticed_by_its_tests():
    ran = run("benchmarks/mutation.py", "--only", "outage", "--each", "6", "--least", "60")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "of    6 noticed" in ran.stdout


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_minutes_of_faults_leak_nothing_and_leave_nothing_unexplained():
    ran = run("benchmarks/soak.py", "--minutes", "12", "--stretch", "1")
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_table_is_printed_and_left_as_json_and_picture(tmp_path):
    ran = run("benchmarks/table.py", "--only", "plant,virtual_bench,growth", "--out", str(tmp_path))
    assert ran.returncode == 0, ran.stdout + ran.stderr
    facts = json.loads((tmp_path / "bench.json").read_text())
    assert len(facts["rows"]) == 2
    assert all(row["what"] in ran.stdout for row in facts["rows"])
    assert "exponent" in (tmp_path / "bench.svg").read_text()


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_several_faults_at_once_let_no_robot_go_that_could_be_held():
    ran = run("benchmarks/multiple_faults.py", "--runs", "0:4", "--processes", "2")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "own: 4 runs, 0 red" in ran.stdout
