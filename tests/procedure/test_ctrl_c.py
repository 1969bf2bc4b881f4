"""Ctrl-C once, on the program itself: it ends soon, whatever it is at, with what was finished until then."""

import json
import os
import signal
import subprocess
import sys

import pytest

ENDLESS = """
from hil.procedure import Measurement, procedure

@procedure(name="endless", needs=("imu",), measurements=[
    Measurement("first", "m"), Measurement("rest", "m"), Measurement("second", "m")])
def run(ctx):
    kept = []
    ctx.on_early_end(lambda: ctx.measure("rest", sum(kept)))
    with ctx.step("a first step"):
        ctx.measure("first", 1.0)
    with ctx.step("what takes for ever"):
        kept.append(2.0)
        {wait}
    with ctx.step("a later step"):
        ctx.measure("second", 3.0)
"""
WAITS = {
    "in the loop": 'print("there", flush=True); ctx.bench.observe(1e6)',
    "in its own code": 'import time; print("there", flush=True); time.sleep(1e6)',
}


def struck(words, folder, **settings):
    """Exit code, output and messages of a command that is sent SIGINT when it has said `there`."""
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from hil.cli import script; sys.argv[0] = 'hil'; script()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, *words],
        cwd=folder,
        text=True,
        env={**os.environ, **settings},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        said = iter(process.stdout.readline, "")
        next(line for line in said if "there" in line)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=600)
    return process.returncode, out, err


@pytest.mark.parametrize("wait", ["in the loop", pytest.param("in its own code", marks=pytest.mark.long)])
def test_a_procedure_ends_with_what_it_has_measured(wait, tmp_path):
    (tmp_path / "endless.py").write_text(ENDLESS.format(wait=WAITS[wait]))
    code, _, err = struck(["run", "endless.py", "--out", "out"], tmp_path)
    assert code == 4, err
    assert "Traceback" not in err
    reported = json.loads((tmp_path / "out" / "result.json").read_text())
    assert reported["verdict"] == "ABORTED"
    assert {row["name"]: row["value"] for row in reported["measurements"]} == {
        "first": 1.0,
        "rest": 2.0,
        "second": None,
    }
    assert reported["error"]["step"] == "what takes for ever"
    assert not reported["teardown_errors"]
    assert (tmp_path / "out" / "report.html").is_file()
