"""The mutation test alters what it says, and notices what tests notice; the soak explains every stop."""

import ast
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
MUTATION = runpy.run_path(str(ROOT / "benchmarks" / "mutation.py"))
SOURCE = '''
def f(a: "int | None", *, b: float = 2.0) -> bool:
    """Says 1 < 2."""
    g(f"{a - 1} is odd")
    if a in (3,) and not b:
        raise ValueError("no")
    return abs(a) < min(-a, b)
'''


def changed(source, each=0):
    found = MUTATION["changes"](source, each, np.random.default_rng(0))
    return [ast.unparse(change.tree) for change in found]


def test_one_thing_is_changed_at_a_time_and_no_text():
    before = ast.unparse(ast.parse(SOURCE)).splitlines()
    lines = []
    for after in map(str.splitlines, changed(SOURCE)):
        assert len(after) == len(before)
        lines += [new.strip() for old, new in zip(before, after, strict=True) if old != new]
    assert len(lines) == len(changed(SOURCE))
    assert set(lines) >= {
        "def f(a: 'int | None', *, b: float=4.0) -> bool:",
        "pass",
        "if a not in (3,) and (not b):",
        "if a in (3,) or not b:",
        "if a in (3,) and b:",
        "return abs(a) >= min(-a, b)",
        "return a < min(-a, b)",
        "return abs(a) < max(-a, b)",
        "return abs(a) < min(a, b)",
    }
    assert not any("Says" in line or "odd" in line for line in lines)
    assert len(changed(SOURCE, 3)) == 3


def test_every_module_and_its_tests_are_there():
    for file, tests in MUTATION["MODULES"].values():
        files = [word for word in (file, *tests) if word.endswith(".py")]
        assert all((ROOT / path).is_file() for path in files)
        assert len(files) > 1


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
