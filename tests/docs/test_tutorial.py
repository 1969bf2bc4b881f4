"""The tutorial works as printed: each file is saved, each line is run in order, in an empty folder."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCK = re.compile(
    r"(?:Save this as `(?P<name>[\w.]+)`:\n\n)?```(?P<kind>sh|python)\n(?P<text>.*?)^```", re.S | re.M
)


PYTHON = shlex.quote(sys.executable)
RUN = {"hil": f"{PYTHON} -m hil ", "python": f"{PYTHON} "}
STOPS = {"hil run climb.py --fault tracker:silent@1"}
"""Lines of which the page says that they end with exit code 3."""


def steps():
    """(line, how it is run, its exit code); the lines that set up an environment are tried elsewhere."""
    for block in BLOCK.finditer(TUTORIAL):
        if block["kind"] == "python":
            continue
        for line in block["text"].splitlines():
            if re.match(r"mkdir|python3 -m venv|\. \.venv|python -m pip|hil info --compile", line):
                continue
            yield (
                line,
                re.sub(r"(?:^|(?<= do ))(hil|python) ?", lambda m: RUN[m[1]], line),
                3 if line in STOPS else 0,
            )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("my-bench")
    for block in BLOCK.finditer(TUTORIAL):
        if block["kind"] == "python":
            (place / block["name"]).write_text(block["text"])
    return place


def run(folder, line):
    return subprocess.run(["sh", "-c", line], cwd=folder, capture_output=True, text=True, timeout=600)


def end_error_mm(text):
    """Of the line with the verdict; other processors round otherwise, by a few micrometres in the end."""
    return float(re.search(r"^PASS: climb\..*end error ([\d.]+) mm", text, re.M)[1])


def test_every_block_of_code_says_where_it_is_saved():
    names = [b["name"] for b in BLOCK.finditer(TUTORIAL) if b["kind"] == "python"]
    assert names == ["climb.py", "test_climb.py"]
    assert {line for line, _, _ in steps()} >= STOPS


@pytest.mark.long
@pytest.mark.parametrize(("line", "command", "code"), [pytest.param(*step, id=step[0]) for step in steps()])
def test_every_line_works_in_order(folder, line, command, code):
    done = run(folder, command)
    assert done.returncode == code, f"{line}\n{done.stdout}{done.stderr}"
    if line == "hil run climb.py":
        assert end_error_mm(done.stdout) == pytest.approx(end_error_mm(TUTORIAL), abs=0.02), "as printed"
    if line == "hil results trends":
        assert "end_error drifts by +" in done.stdout
    if line == "hil results list":
        assert "end_error" in done.stdout
