"""examples/labgrid on a lab of its own: two callers, one that is killed, and a connection that is cut."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.labgrid.lab import Lab, sshd, wait_for

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),
    pytest.mark.skipif(sshd() is None, reason="there is no SSH server (Debian: openssh-server)"),
]
SLOW = """
from hil.procedure import Context, Measurement, procedure

@procedure(name="slow", needs=("servos",), measurements=[Measurement("cycles", "1", low=1.0)])
def run(ctx: Context) -> None:
    '''Rests for as long as it is let.'''
    for number in range(100000):
        ctx.bench.observe(1.0)
        if number == 1:
            ctx.note("it has begun")
            open("begun", "w").close()
    ctx.measure("cycles", 1.0)
"""
QUICK = SLOW.replace("100000", "2").replace('"slow"', '"quick"')


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    """Folder of labgrid's commands: those on PATH, else from an environment made for these tests."""
    found = shutil.which("labgrid-client")
    if found:
        return Path(found).parent
    folder = tmp_path_factory.mktemp("tools")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    install = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "labgrid>=26"]
    if subprocess.run(install, timeout=600).returncode:
        pytest.skip("labgrid is not installed, and no package index can be reached")
    return folder / "bin"


@pytest.fixture
def lab(tools):
    with tempfile.TemporaryDirectory(prefix="lab") as folder, Lab(Path(folder), tools) as begun:
        (begun.bench / "slow.py").write_text(SLOW)
        (begun.bench / "quick.py").write_text(QUICK)
        yield begun


def result_on_the_bench(lab):
    """`result.json` that the bench's computer has written, once it is there."""
    (path,) = wait_for(lambda: list(lab.bench.glob("results-*/result.json")))
    return json.loads(path.read_text())


def test_two_callers_at_once_one_waits_and_both_get_their_results(lab):
    first = lab.call("anna", "run", "slow.py")
    wait_for((lab.bench / "begun").exists)
    assert lab.has_place() == "loopback/anna"
    second = lab.call("ben", "run", "quick.py")
    wait_for(lambda: "waiting" in lab.says("ben"))
    assert lab.has_place() == "loopback/anna"
    assert first.poll() is None
    os.kill(first.pid, signal.SIGINT)
    assert first.wait(120) == 4
    assert json.loads((lab.folder / "anna" / "result.json").read_text())["verdict"] == "ABORTED"
    assert second.wait(240) == 0
    assert "PASS" in lab.says("ben")
    brought = json.loads((lab.folder / "ben" / "result.json").read_text())
    assert (brought["procedure"], brought["held"]["state"]) == ("quick", "HELD")
    assert (lab.folder / "ben" / "report.html").stat().st_size > 10_000
    wait_for(lambda: not lab.has_place())


def test_a_killed_caller_leaves_the_robot_held_and_the_place_free(lab):
    caller = lab.call("anna", "run", "slow.py")
    wait_for((lab.bench / "begun").exists)
    os.kill(caller.pid, signal.SIGKILL)
    left = result_on_the_bench(lab)
    assert (left["verdict"], left["held"]["state"]) == ("ABORTED", "HELD")
    wait_for(lambda: not lab.has_place())


def test_a_connection_that_is_cut_leaves_the_robot_held_and_the_place_free(lab):
    """Nothing comes through any more, and neither end is informed."""
    lab.call("anna", "run", "slow.py")
    wait_for((lab.bench / "begun").exists)
    for number in lab.of_this_lab("ssh"):
        os.kill(number, signal.SIGSTOP)
    left = result_on_the_bench(lab)
    assert (left["verdict"], left["held"]["state"]) == ("ABORTED", "HELD")
    wait_for(lambda: not lab.has_place())
