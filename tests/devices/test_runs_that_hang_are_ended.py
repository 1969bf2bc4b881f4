"""A run that is not in a cycle ends by the second Ctrl-C or by SIGTERM, also within another's driver."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from faulty_package import PACKAGE, driver
from installing import environment

pytestmark = pytest.mark.usefixtures("warm_commands")

STUCK = """def {method}(self):
        print("in {method}", file=sys.stderr, flush=True)
        while True:
            try: time.sleep(0.01)
            except Exception: pass
"""
DECLARES = """
import sys
from hil.procedure import procedure


def declared(parameters):
    print("in declared", file=sys.stderr, flush=True)
    while True: pass


@procedure(name="look", needs=("thing",), measurements=declared)
def run(ctx):
    pass
"""
TWICE, TERM = [signal.SIGINT, signal.SIGINT], [signal.SIGTERM]


def ended(folder, packages, awaited, signals):
    """The process of a run that is sent signals once it has said where it is; at most half a minute."""
    words = ["run", "look.py", "--bench", "bench.toml", "--out", "out", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *words],
        cwd=folder,
        env=environment(*packages),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        while (line := process.stderr.readline()) and awaited not in line:
            pass
        for number in signals:
            time.sleep(0.2)
            os.kill(process.pid, number)
        began_s = time.monotonic()
        out, said = process.communicate(timeout=25.0)
        return process.returncode, out, said, time.monotonic() - began_s
    finally:
        process.kill()
        process.wait()


@pytest.mark.usefixtures("bench")
def test_a_run_ends_while_a_driver_does_not_open(tmp_path, package):
    folder = package("hil-evil", PACKAGE + driver(STUCK.format(method="open")), "ITEM", version="6.6")
    code, out, said, took_s = ended(tmp_path, [folder], "in open", TWICE)
    assert code == 4, said
    reported = json.loads(out)
    assert reported["verdict"] == "ABORTED"
    assert "while this was running: thing (hil-evil 6.6): open()" in reported["error"]["message"]
    assert took_s < 20.0


@pytest.mark.usefixtures("bench")
def test_a_run_ends_while_its_script_declares_for_ever(tmp_path, package):
    (tmp_path / "look.py").write_text(DECLARES)
    folder = package("hil-good", PACKAGE + "\n\nITEM = thing()\n", "ITEM")
    code, out, said, took_s = ended(tmp_path, [folder], "in declared", TERM)
    assert code == 4, said
    assert json.loads(out)["error"]["exit_code"] == 4
    assert took_s < 20.0


def test_a_driver_that_opens_slowly_is_open_before_a_run_is_ended(tmp_path, package, bench):
    """So that a robot on a wall is held, and a healthy device is let go of as it should be."""
    body = STUCK.format(method="open").partition("while")[0] + "for _ in range(10): time.sleep(0.1)\n"
    body += """
    def close(self):
        print("closed", file=sys.stderr, flush=True)
"""
    folder = package("hil-slow", PACKAGE + driver(body), "ITEM")
    code, out, said, _ = ended(tmp_path, [folder], "in open", TERM)
    assert code == 4, said
    assert json.loads(out)["error"]["message"].startswith("stopped at once by STOP")
    assert "closed" in said
