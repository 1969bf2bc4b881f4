"""The process with the button: little can go wrong in it, and it goes when it is not needed any more."""

import json
import os
import subprocess
import sys
import time
import urllib.request

import pytest

from hil.console import jobs, stop_server
from hil.console.stop_server import ASKED, PAGE, STOP, StopProcess
from hil.console.web_server import Request
from tests.console.test_jobs import HELD, job_in

ASKING = Request("/state", {}, {}, "127.0.0.1")


def test_it_needs_the_standard_library_alone():
    code = (
        "import sys; before = set(sys.modules); import hil.console.stop_server, hil.console.job_process\n"
        "came = {name.split('.')[0] for name in sys.modules.keys() - before}\n"
        "print(*sorted(came - set(sys.stdlib_module_names)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["hil"]


class Shut:
    """A server that only knows that it was shut."""

    def __init__(self):
        self.shut = False

    def shutdown(self):
        self.shut = True


@pytest.fixture
def time_passes(monkeypatch):
    """Half a second a look; after a quarter of an hour it is over."""

    class Time:
        now_s = 0.0
        after = ()

        def monotonic(self):
            return self.now_s

        def time(self):
            return 0.0

        def sleep(self, seconds):
            self.now_s += 10.0
            for due_s, do in self.after:
                if due_s <= self.now_s < due_s + 10.0:
                    do()
            assert self.now_s < 5000.0, "it stays for ever"

    made = Time()
    monkeypatch.setattr(stop_server, "time", made)
    return made


def test_it_ends_with_a_page_that_ends_in_order(tmp_path, time_passes):
    (tmp_path / PAGE).write_text(json.dumps(jobs.identity(os.getpid()) | {"port": 1}))
    ended = json.dumps({"ended": True})
    time_passes.after = ((1000.0, lambda: (tmp_path / PAGE).write_text(ended)),)
    server = Shut()
    StopProcess(tmp_path).serve_until_idle(server)
    assert server.shut
    assert 1000.0 <= time_passes.now_s < 1020.0


def test_it_stays_while_something_runs_and_then_for_ten_minutes_when_the_page_was_killed(
    tmp_path, time_passes
):
    (tmp_path / PAGE).write_text(json.dumps({"pid": 1 << 22, "ticks": 1, "boot": "", "port": 1}))
    job = job_in(tmp_path / "jobs", process=jobs.identity(os.getpid()))
    gone = json.dumps({"pid": 1 << 22, "ticks": 1, "boot": ""})
    time_passes.after = ((1000.0, lambda: (job.folder / jobs.PROCESS).write_text(gone)),)
    StopProcess(tmp_path).serve_until_idle(Shut())
    assert 1580.0 <= time_passes.now_s < 1630.0


def test_its_page_knows_whether_the_console_lives_and_how_the_last_run_left_the_robot(tmp_path):
    process = StopProcess(tmp_path)
    (tmp_path / PAGE).write_text(json.dumps(jobs.identity(os.getpid()) | {"port": 4321}))
    job_in(tmp_path / "jobs", out=json.dumps({"verdict": "ABORTED", "held": HELD}))
    reported = json.loads(process.routes()["GET", "/state"](ASKING).content)
    assert reported["page"] == 4321
    assert [job["words"] for job in reported["jobs"]] == ["x: HELD: at rest"]
    (tmp_path / PAGE).write_text(json.dumps({"pid": 1 << 22, "ticks": 1, "boot": "", "port": 4321}))
    assert json.loads(process.routes()["GET", "/state"](ASKING).content)["page"] is None


def test_it_serves_by_itself_from_a_folder(tmp_path):
    """As the console starts it, without a console."""
    (tmp_path / ASKED).write_text(json.dumps({"port": 0, "token": "secret", "cookie": "hil_x"}))
    process = subprocess.Popen([sys.executable, "-m", "hil.console.stop_server", str(tmp_path)])
    try:
        end_s = time.monotonic() + 30.0
        while not (tmp_path / STOP).exists():
            assert time.monotonic() < end_s
            time.sleep(0.02)
        reported = json.loads((tmp_path / STOP).read_text())
        assert (tmp_path / STOP).stat().st_mode & 0o077 == 0
        request = urllib.request.Request(
            f"http://127.0.0.1:{reported['port']}/stop",
            b"{}",
            {"Authorization": "Bearer secret", "Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=10) as reply:
            assert json.load(reply) == {"asked": []}
    finally:
        process.terminate()
        process.wait(10)
