"""A campaign on a Dask cluster whose machines share no files with the one that started it."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib import resources
from pathlib import Path
from threading import Thread

import pytest

from hil.calibration.calibration_file import save_calibration
from hil.cli import main
from tests.procedures.made_calibrations import made

distributed = pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")

SCRIPT = '''
"""A procedure of a moment."""
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from moment_helper import MM_PER_M

from hil.procedure import Context, Measurement, procedure


@dataclass
class Parameters:
    hold_s: float = 0.2


@procedure(
    name="rest", needs=("mocap",), parameters=Parameters,
    measurements=[
        Measurement("drift", "mm", high=20.0, rationale="it holds itself"),
        Measurement("radius", "mm", rationale="of the wheels that the calibration gives"),
    ],
)
def run(ctx: Context) -> None:
    """Hold for a moment."""
    with ctx.step("rest"):
        ctx.bench.devices.servos.enable()
        seen = ctx.bench.observe(ctx.parameters.hold_s, feedback="odometry").mocap[:, 0]
    ctx.measure("drift", MM_PER_M * float(np.nanmax(seen) - np.nanmin(seen)))
    ctx.measure("radius", MM_PER_M * float(ctx.bench.geometry.radius_m[0]))
'''
BLIND = '''
"""A worker that can see nothing below a folder, as if it were another machine."""
import os
import sys

_HIDDEN = tuple(os.environ["HIDDEN"].split(os.pathsep))

def refuse(event, arguments):
    if event in ("open", "os.listdir", "os.mkdir", "os.scandir") and str(arguments[0]).startswith(_HIDDEN):
        raise PermissionError(13, "this worker does not share it", str(arguments[0]))

def dask_setup(worker):
    sys.addaudithook(refuse)
'''
OTHER = '''
"""A worker with another version of the package."""
import hil

hil.__version__ = "0.0.7"
'''


class Cluster:
    """A scheduler and workers as processes, each in a folder of its own."""

    def __init__(self, folder):
        self.folder, self.processes, self.address = folder, [], ""

    def _start(self, name, *arguments, **environment):
        own = self.folder / name
        own.mkdir(parents=True)
        path = os.pathsep.join(p for p in sys.path if p)
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            cwd=own,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path, "TMPDIR": str(own), **environment},
        )
        self.processes.append(process)
        return process

    def start(self, *options):
        """The scheduler; its address comes from a file."""
        reported = self.folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            str(reported),
            *options,
        )
        deadline = time.monotonic() + 60
        while not (reported.exists() and reported.read_text().endswith("}")) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.address = json.loads(reported.read_text())["address"]
        return self

    def worker(self, name, preload, *hidden):
        """One more worker, which loads `preload` first; returns when the scheduler knows it."""
        own = self.folder / f"{name}.py"
        own.parent.mkdir(parents=True, exist_ok=True)
        own.write_text(preload)
        before = self.workers()
        self._start(
            name,
            "distributed.cli.dask_worker",
            self.address,
            "--no-dashboard",
            "--nthreads",
            "1",
            "--local-directory",
            str(self.folder / name),
            "--preload",
            str(own),
            "--no-nanny",
            HIDDEN=os.pathsep.join(map(str, hidden)),
        )
        deadline = time.monotonic() + 60
        while self.workers() == before and time.monotonic() < deadline:
            time.sleep(0.1)

    def workers(self):
        with distributed.Client(self.address, timeout=30) as client:
            return len(client.scheduler_info(n_workers=-1)["workers"])

    def end(self):
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            with suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path):
    found = Cluster(tmp_path / "elsewhere").start()
    yield found
    found.end()


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The folder of who starts campaigns: a procedure with a module, a bench file that names a file."""
    folder = tmp_path / "here"
    (folder / "cal").mkdir(parents=True)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "moment_helper", raising=False)
    Path("rest.py").write_text(SCRIPT)
    Path("moment_helper.py").write_text("MM_PER_M = 1e3\n")
    save_calibration(Path("cal/calibration.toml"), made(0.0253))
    profile = resources.files("hil.config.profiles").joinpath("emulated_floor.toml").read_text()
    Path("bench.toml").write_text(f'calibration = "cal/calibration.toml"\n{profile}')
    Path("late.toml").write_text('[[fault]]\ndevice = "tracker"\nkind = "slow"\nat_s = 0.1\n')
    return folder


def campaign(capsys, *options):
    """Exit code, JSON and stderr of a campaign on the bench of the folder, with a timeline of faults."""
    capsys.readouterr()
    common = ("--bench", "bench.toml", "--fault", "late.toml")
    code = main(["campaign", "rest.py", *common, *options, "--json"])
    said = capsys.readouterr()
    return code, json.loads(said.out), said.err


@pytest.mark.long
@pytest.mark.timeout(300)
def test_files_and_results_travel_through_the_scheduler(cluster, here, capsys):
    code, alone, _said = campaign(capsys, "--seeds", "0:8", "--workers", "0", "--out", "alone")
    assert code == 0, _said
    for machine, other in (("one", "two"), ("two", "one")):
        for worker in "ab":
            cluster.worker(f"{machine}/{worker}", BLIND, here, cluster.folder / other)
    options = ("--seeds", "0:8", "--scheduler", cluster.address, "--out", "far")
    code, far, said = campaign(capsys, *options)
    assert code == 0, said
    assert cluster.workers() == 4
    assert [r["measurements"] for r in far["rows"]] == [r["measurements"] for r in alone["rows"]]
    for row in far["rows"]:
        assert row["folder"] == str(here / "far" / "runs" / row["case"])
        assert names(here / "far" / "runs" / row["case"]) == names(here / "alone" / "runs" / row["case"])
        assert (here / "far" / "rows" / f"{row['case']}.parquet").exists()
    left = [p for name in ("one", "two") for p in (cluster.folder / name).rglob("result.json")]
    assert left == []
    again = shlex.split(far["rows"][2]["command"])[1:]
    assert main([*again, "--out", "again", "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert {m["name"]: m["value"] for m in tree["measurements"]} == {
        name: m["value"] for name, m in far["rows"][2]["measurements"].items()
    }


def names(folder):
    """All files below a folder."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("preload", "reported"),
    [(None, "has no workers"), (OTHER, "has hil 0.0.7, this computer"), (BLIND, "")],
    ids=["none", "other version", "same"],
)
def test_a_cluster_of_another_make_is_refused(cluster, here, capsys, preload, reported):
    if preload is not None:
        cluster.worker("one", preload, here)
    code, _, said = campaign(capsys, "--seeds", "0", "--scheduler", cluster.address, "--out", "far")
    assert (code, reported in said) == (2 if reported else 0, True), said


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_scheduler_without_this_package_is_refused(tmp_path, here, capsys):
    (tmp_path / "bare.py").write_text('import sys\nsys.modules["hil"] = None\n')
    bare = Cluster(tmp_path / "elsewhere").start("--preload", str(tmp_path / "bare.py"))
    try:
        bare.worker("one", BLIND, here)
        code, _, said = campaign(capsys, "--seeds", "0", "--scheduler", bare.address, "--out", "far")
    finally:
        bare.end()
    assert (code, f"Dask scheduler '{bare.address}' has no hil-4wis4wid, or another one" in said) == (
        2,
        True,
    ), said


def once(folder, act):
    """Act, in a thread of its own, as soon as a campaign has two results."""

    def look():
        deadline = time.monotonic() + 200
        while len(list(folder.rglob("result.json"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        act()

    Thread(target=look, daemon=True).start()


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_worker_that_is_killed_loses_no_other_run(cluster, here, capsys):
    cluster.worker("one", BLIND, here)
    cluster.worker("two", BLIND, here)
    doomed = cluster.processes[-1]
    once(here / "far", lambda: doomed.send_signal(signal.SIGKILL))
    options = ("--seeds", "0:12", "--set", "hold_s=3", "--scheduler", cluster.address, "--out", "far")
    code, tree, said = campaign(capsys, *options)
    assert "verdicts" in tree, tree
    assert (code, tree["verdicts"]) == (0, {"PASS": 12}), said
    assert doomed.poll() is not None


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_scheduler_that_vanishes_is_named_and_what_is_finished_is_kept(cluster, here, capsys):
    cluster.worker("one", BLIND, here)
    once(here / "far", lambda: [p.send_signal(signal.SIGKILL) for p in cluster.processes])
    options = ("--seeds", "0:40", "--set", "hold_s=3")
    code, _, said = campaign(capsys, *options, "--scheduler", cluster.address, "--out", "far")
    assert code == 4
    assert f"Dask scheduler '{cluster.address}' has gone" in said
    assert "--resume" in said
    assert "Traceback" not in said
    finished = {p.parent.name for p in (here / "far").rglob("result.json")}
    assert 0 < len(finished) < 40
