"""`hil info --compile` loads or compiles what a run needs, and says how far it is."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from numba.core import event

from hil.bench import open_bench
from hil.cli import main
from hil.robot.trajectories import line


class Compiled(event.Listener):
    """Functions that are compiled."""

    def __init__(self):
        self.names = []

    def on_start(self, reported):
        self.names.append(reported.data["dispatcher"].py_func.__qualname__)

    def on_end(self, _):
        pass


def test_a_run_after_it_compiles_nothing(capsys):
    assert main(["info", "--compile", "--json"]) == 0
    reported = capsys.readouterr()
    assert json.loads(reported.out)["hil"]
    with event.install_listener("numba:compile", listener := Compiled()), open_bench("emulated") as bench:
        bench.drive(line((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), duration_s=1.0), feedback="ekf")
    assert listener.names == []


def test_sigterm_ends_its_processes_and_leaves_no_warning(tmp_path):
    """It comes once two processes and their tracker have begun."""
    began = subprocess.Popen(
        [sys.executable, "-m", "hil", "info", "--compile"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    children = Path(f"/proc/{began.pid}/task/{began.pid}/children")
    while began.poll() is None and len(children.read_text().split()) < 3:
        time.sleep(0.01)
    began.terminate()
    _, said = began.communicate(timeout=60)
    assert began.returncode == 4
    assert said.splitlines()[-1] == "hil: ended by SIGTERM; what is compiled is kept"
    assert "Traceback" not in said
    assert "resource_tracker" not in said
