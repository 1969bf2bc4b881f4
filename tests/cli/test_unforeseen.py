"""Unexpected exceptions: a traceback for the bug report, exit code 4, one JSON object; and two causes."""

import json
import subprocess
import sys

import pytest

from hil import bench as benches
from hil.cli import main
from tests.patience import patient_bench
from tests.selected import every

SCRIPT = """
from hil.procedure import Measurement, procedure

@procedure(name="short", needs=("imu",), measurements=[Measurement("value", "m", high=1.0)])
def run(ctx):
    ctx.measure("value", 0.5)
"""
LONG = "n" * 300
NAMED = {
    "replay": ["replay", f"{LONG}.mcap"],
    "run --out": ["run", "short.py", "--out", LONG],
    "run --bench": ["run", "short.py", "--bench", f"{LONG}.toml"],
    "live": ["live", "--record", f"{LONG}.mcap"],
    "robot": ["robot", "show", LONG],
    "a key": ["run", "short.py", "--set", f"bench.calibration={LONG}"],
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "short.py").write_text(SCRIPT)
    (tmp_path / "x.mcap").write_bytes(b"")
    (tmp_path / "x").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("raised", [KeyError("lost"), GeneratorExit()], ids=repr)
def test_an_unexpected_exception_is_a_defect(raised, monkeypatch, capsys):
    def failing(*args, **kwargs):
        raise raised

    monkeypatch.setattr(benches, "open_emulation", failing)
    assert main(["emulate", "--json"]) == 4
    said = capsys.readouterr()
    reported = json.loads(said.out)["error"]
    name = type(raised).__name__
    assert reported["message"].startswith(name)
    assert reported["exit_code"] == 4
    assert "Traceback" in said.err
    assert said.err.splitlines()[-1].startswith(f"hil: {name}")


@pytest.mark.parametrize("case", NAMED)
def test_a_name_that_no_file_can_have_is_refused_in_a_line(case, folder, capsys, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of the script beside
    before = sorted(p.name for p in folder.iterdir())
    assert main([*NAMED[case], "--json"]) == 2
    said = capsys.readouterr()
    reported = json.loads(said.out)["error"]
    assert LONG in reported["message"]
    assert "Traceback" not in said.err
    assert len(said.err.splitlines()) == 1
    assert sorted(p.name for p in folder.iterdir()) == before


@pytest.mark.real_time
@pytest.mark.parametrize(
    "words",
    every(
        2,
        [
            ["run", "short.py", "--json"],
            ["live", "--bench", "bench.toml", "--duration", "0.3", "--no-record", "--json"],
        ],
    ),
)
@pytest.mark.usefixtures("warm_commands")
def test_a_closed_standard_input_is_an_empty_one(words, folder):
    """As a service or a container may have it."""
    patient_bench(folder, "emulated")
    command = ["sh", "-c", 'exec "$@" <&-', "sh", sys.executable, "-m", "hil", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert not json.loads(done.stdout).get("error")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("raised", "where"),
    [
        ("GeneratorExit", "load"),
        ("SystemExit(0)", "measurements"),
        ("KeyError('x')", "body"),
        ("type('E', (BaseException,), {})", "body"),
        ("SystemExit(0)", "teardown"),
    ],
)
def test_a_script_may_raise_anything(raised, where, folder, capsys):
    (folder / "bad.py").write_text(f"""
from hil.procedure import Measurement, procedure

def end():
    raise {raised}

def declared(parameters):
    return end() if {where!r} == "measurements" else ()

@procedure(name="short", needs=("imu",), measurements=declared)
def run(ctx):
    ctx.bench.observe(0.1)
    ctx.on_teardown(end if {where!r} == "teardown" else print)
    if {where!r} == "body":
        end()

if {where!r} == "load":
    end()
""")
    assert main(["run", "bad.py", "--out", "out", "--json"]) == 2
    said = capsys.readouterr()
    reported = json.loads(said.out)
    assert "Traceback" not in said.err
    if where in ("load", "measurements"):
        assert "bad.py" in reported["error"]["message"]
    else:
        assert reported["verdict"] == "ERROR"
        found = reported["error"] or reported["teardown_errors"][0]
        assert "(bad.py, line 5)" in found["message"]
        assert reported["held"]["state"] != "NOT HELD"
