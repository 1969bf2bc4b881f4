"""The blocks that start the emulator and others' own clients, pasted into a shell as they are printed."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("page", ["README.md", pytest.param("examples/README.md", marks=pytest.mark.long)])
def test_the_block_works_as_printed(tmp_path, page):
    """At once and line by line: the scripts wait for the file, which goes with the emulator."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n(hil emulate --out.*?)^```", text, re.DOTALL | re.MULTILINE)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "bin").mkdir()
    python = shlex.quote(sys.executable)
    for name, call in (("hil", "-m hil "), ("python", "")):
        (tmp_path / "bin" / name).write_text(f'#!/bin/sh\nexec {python} {call}"$@"\n')
        (tmp_path / "bin" / name).chmod(0o755)
    environment = {"PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    ended = "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n"
    done = subprocess.run(
        ["bash", "-e", "-c", f"{ended}{block}wait"],
        cwd=tmp_path,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert [f"servo {i}: model " in done.stdout for i in range(1, 9)] == [True] * 8, done.stdout
    assert not (tmp_path / "endpoints.json").exists()
