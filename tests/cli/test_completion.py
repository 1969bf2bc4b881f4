"""The shell completes a line, asking the program as it does; and `--help` is quick: it imports no command."""

import json
import os
import shlex
import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ZshComplete

from hil.cli import cli


def test_a_shell_that_is_not_known_is_named():
    done = subprocess.run(
        [sys.executable, "-m", "hil"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "_HIL_COMPLETE": "ash_source"},
    )
    assert done.returncode == 2
    assert "ash_source" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture
def here(tmp_path):
    """A folder with a bench file, a script and one result."""
    (tmp_path / "lab.toml").write_text("schema = 1\n")
    (tmp_path / "mine.py").write_text(
        "from dataclasses import dataclass\nfrom hil.procedure import procedure\nprint('loud')\n"
        "@dataclass\nclass P:\n    laps: int = 3\n"
        "@procedure(name='mine', parameters=P)\ndef run(ctx): pass\n"
    )
    (tmp_path / "broken.py").write_text("print('loud')\nraise SystemExit(3)\n")
    run = tmp_path / "out" / "mine" / "20260131-101500-000"
    run.mkdir(parents=True)
    (run / "journal.jsonl").write_text(json.dumps({"kind": "run", "schema": 1, "procedure": "mine"}) + "\n")
    return tmp_path


KNOWN = {
    "a procedure": (["run"], "wall_t", ["wall_tracking"]),
    "a script": (["run"], "mi", ["mine.py"]),
    "a profile": (["doctor", "--bench"], "emulated_f", ["emulated_floor"]),
    "a bench file": (["run", "mine.py", "--bench"], "la", ["lab.toml"]),
    "a parameter": (["run", "mine.py", "--set"], "la", ["laps=3"]),
    "a device": (["live", "--emulate"], "moc", ["mocap"]),
    "a result": (["results", "open"], "mi", ["mine/20260131-101500-000"]),
    "the latest": (["results", "open"], "la", ["last"]),
    "a folder of results": (["report"], "out/", ["out/mine/20260131-101500-000"]),
}


def offers(words, begun):
    """What the program offers a shell after these words, for what has been begun."""
    found = ZshComplete(cli, {"obj": words}, "hil", "_HIL_COMPLETE").get_completions(words, begun)
    return [item.value for item in found if item.type == "plain"]


@pytest.mark.parametrize("case", KNOWN)
def test_what_there_is_is_offered(case, here, monkeypatch):
    monkeypatch.chdir(here)
    words, begun, expected = KNOWN[case]
    assert offers(words, begun) == expected


def test_a_fault_is_completed_part_by_part():
    assert {"imu:", "servos:"} <= set(offers(["run", "--fault"], ""))
    assert "imu:stuck" in offers(["run", "--fault"], "imu")
    assert offers(["run", "--fault"], "imu:stu") == ["imu:stuck"]
    assert "tracker:" not in offers(["run", "--bench", "sensors", "--fault"], "")


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("words", "reply"),
    [(["run", "mine.py", "--set", "laps", "="], ["3"]), (["run", "broken.py", "--set", "la"], [])],
)
def test_bash_itself_completes(words, reply, here):
    """By the script that it is given; bash takes `laps=` for two words. A script may print, or end itself."""
    program = here / "hil"
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m hil "$@"\n')
    program.chmod(0o755)
    line = shlex.join(["hil", *words])
    done = subprocess.run(
        [
            "bash",
            "-c",
            'eval "$(_HIL_COMPLETE=bash_source hil)"; '
            f"COMP_WORDS=({line}); COMP_CWORD={len(words)}; _hil_completion hil; "
            'printf "%s\n" "${COMPREPLY[@]}"',
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=here,
        env={**os.environ, "PATH": f"{here}{os.pathsep}{os.environ['PATH']}"},
    )
    assert (done.stdout.split(), done.stderr) == (reply, "")


def test_help_imports_no_command_and_nothing_heavy():
    """Within 0.2 s: what costs time is what is imported, whatever computer this is."""
    code = (
        "import sys; from hil.cli import main; main(['--help']); print(*sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert not {m.split(".")[0] for m in loaded} & {
        "numpy",
        "scipy",
        "pydantic",
        "matplotlib",
        "rich",
        "jinja2",
    }
    assert {m for m in loaded if m.startswith("hil.cli.")} <= {"hil.cli.options", "hil.cli.closed_output"}
