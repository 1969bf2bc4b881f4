"""`hil info --compile` loads or compiles what a run needs, and says how far it is."""

import json

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
