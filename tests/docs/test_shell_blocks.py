"""What pages print for a shell: every line parses, and README's are run, in a form that ends soon.

A line of README that no rule knows fails its test, so that a new one is thought about.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli import main

ROOT = Path(__file__).resolve().parents[2]
BUILDS = "--no-deps --no-build-isolation --quiet"


def shell_lines(page, languages=("sh",)):
    """Lines of the blocks in one of the languages, those that go on joined."""
    state, found = None, []
    for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        fence = re.match(r"\s*```(\w*)\s*$", line)
        if fence is not None:
            state = None if state is not None else fence[1]
        elif state in languages and line.strip():
            found.append(line.strip())
    return found


README = [line for line in shell_lines(ROOT / "README.md") if not line.startswith("#")]


def rule(line):
    """How a line is tried: a shell line that ends soon, or None for one that another test runs as printed."""
    line = line.split("#")[0].strip()
    if line.startswith("make "):
        return f"make -C {shlex.quote(str(ROOT))} -n {line.removeprefix('make ')}"
    if line.startswith("python -m pip install"):
        shown = line.replace("git+file:///path/of/this/folder", "git+file://$PWD")
        return f'cd source && {shown} {BUILDS} --target "$(mktemp -d)"'
    if re.match(r"hil (run \S+ --realtime|run \S+ --bench|run short_line)", line):
        return f"{line} --dry-run"
    if re.match(r"hil (run bring_up|doctor|discover|console|jog)", line):
        return f"{line} --help"
    if line.startswith(("hil emulate --out", "python examples/", "kill %1")):
        return None  # tests/emulate pastes the block
    raise AssertionError(f"no rule says how to try: {line}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a reader has: `python` on the path, a clone, a procedure, a bench file."""
    place = tmp_path_factory.mktemp("reader")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (script,) = (b for b in re.findall(r"^```python\n(.*?)^```", text, re.S | re.M) if "@procedure" in b)
    (place / "short_line.py").write_text(script)
    shutil.copy(ROOT / "hil" / "config" / "profiles" / "emulated.toml", place / "my.toml")
    (place / "bin").mkdir()
    python = place / "bin" / "python"
    python.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    python.chmod(0o755)
    subprocess.run(["git", "clone", "--quiet", ROOT, place / "source"], check=True)
    return place


def tried(place, line):
    path = f"{place / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["sh", "-c", line],
        cwd=place,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=600,
    )


def each(line):
    """A line as a case; building the package is what tests/install/test_wheel.py does by default."""
    marks = [pytest.mark.long] * ("-m pip" in line) + [pytest.mark.real_time] * ("--realtime" in line)
    return pytest.param(line, marks=marks, id=line)


@pytest.mark.parametrize("line", [each(line) for line in README])
def test_every_line_of_the_readme_can_be_pasted(folder, line, monkeypatch):
    shown = rule(line)
    if shown is None:
        return
    if shown.startswith("hil "):
        monkeypatch.chdir(folder)
        assert main(shlex.split(shown)[1:]) == 0
        return
    if "pip" in shown:
        packaging = pytest.importorskip("packaging.version")
        from importlib.metadata import version

        if packaging.Version(version("setuptools")) < packaging.Version("77"):
            pytest.skip("setuptools in this environment is older than 77")
    done = tried(folder, shown)
    assert done.returncode == 0, f"{shown}\n{done.stdout}{done.stderr}"
