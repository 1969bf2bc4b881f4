"""A free domain of DDS, and programs that listen there."""

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.patience import patient_bench
from tests.ros2.fast_dds import build

LISTENER = Path(__file__).with_name("listener.py")
COMMANDER = Path(__file__).with_name("commander.py")
LIMIT_S = 60.0


def _is_free(domain):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


@pytest.fixture
def domain():
    """A domain of which no participant runs on this computer."""
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    begin = os.getpid() % 90
    return next(d for d in (10 + (begin + n) % 90 for n in range(90)) if _is_free(d))


class Listener:
    """`listener.py` as a process of its own."""

    def __init__(self, domain, *topics):
        self._process = subprocess.Popen(
            [sys.executable, str(LISTENER), str(domain), *topics],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def wait(self, participant, *topics):
        """Until both sides have found each other."""
        until = time.monotonic() + LIMIT_S
        while not all(participant.readers(topic) for topic in topics):
            assert time.monotonic() < until, "the listener was not found"
            time.sleep(0.01)
        self.matched()

    def matched(self):
        assert self._process.stdout.readline() == "matched\n"

    def has_heard(self):
        """Until there were twenty messages on the first topic."""
        assert self._process.stdout.readline() == "heard\n"

    def end(self):
        """No more will come; what `ended` is asked for next."""
        self._process.stdin.close()

    def heard(self):
        """What came by topic, and after how long all writers were gone."""
        if not self._process.stdin.closed:
            self.end()
        found = json.loads(self._process.stdout.read().splitlines()[-1])
        return found["heard"], found["gone_after_s"]

    def close(self):
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            pipe.close()


@pytest.fixture
def listen(domain):
    """Begins listeners; they are ended with the test."""
    begun = []

    def begin(*topics):
        begun.append(Listener(domain, *topics))
        return begun[-1]

    yield begin
    for listener in begun:
        listener.close()


@pytest.fixture
def programs():
    """Begins programs of Python; they are ended with the test."""
    begun = []

    def begin(*words, **options):
        command = [sys.executable, *map(str, words)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        begun.append(subprocess.Popen(command, text=True, **pipes, **options))
        return begun[-1]

    yield begin
    for one in begun:
        if one.poll() is None:
            one.kill()
        one.wait()
        for pipe in filter(None, (one.stdin, one.stdout, one.stderr)):
            pipe.close()


@pytest.fixture
def command(domain, programs):
    """Begins a program that sends velocities."""

    def begin(kind, *fields, rate_hz=50):
        begun = programs(COMMANDER, domain, "/cmd_vel", kind, rate_hz, *fields)
        assert begun.stdout.readline() == "begun\n"
        return begun

    return begin


@pytest.fixture
def live(tmp_path, domain, programs):
    """Begins `hil live`, which a topic drives."""

    def begin(topic, *options, **tables):
        bench = patient_bench(tmp_path, "emulated_floor", **tables)
        words = ("live", "--bench", bench, "--controller", f"ros2:{topic}", "--ros2-domain", domain)
        more = ("--record", "r.mcap", *options, "--json")
        return programs("-m", "hil", *words, *more, stderr=subprocess.PIPE, cwd=tmp_path)

    return begin


@pytest.fixture(scope="session")
def wall_line_dds(tmp_path_factory):
    """Path of the controller of `examples/ros2` on Fast DDS; `HIL_WALL_LINE_DDS` names one that is built."""
    given = os.environ.get("HIL_WALL_LINE_DDS")
    return Path(given) if given else build(tmp_path_factory.mktemp("fast_dds"))
