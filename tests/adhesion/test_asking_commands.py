"""A robot that hangs by fan and propellers stays where it is, whatever command only asks something.

Robot, daemon and bench are processes of their own, in real time; what becomes of the robot is its own truth.
"""

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from math import dist

import pytest
from kills import end_daemon, wait_until
from wall_trials import ENVIRONMENT, bench_driving, robot_on_the_wall

from hil.bench.fan_commands import daemon_spec
from hil.config.loading import load_bench

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]
LEAST_SHARE, MOST_M, TURNS_RAD_S, LONGEST_S = 0.9, 1e-3, 0.01, 120.0
STANDS = "--on-stand"
"""Said by mistake: the robot hangs."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """(the emulated robot, which hangs HELD and is not driven, a bench file in which it is real)."""
    folder = tmp_path_factory.mktemp("hanging")
    with pytest.MonkeyPatch.context() as patch, robot_on_the_wall(seed=1) as robot:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        path = robot.bench_file(folder)
        try:
            with bench_driving(path, "patient") as process:
                wait_until(lambda: all(robot.truth()["turning"]), "a driving robot")
                process.terminate()
                process.wait(LONGEST_S)
            yield robot, path
        finally:
            end_daemon(daemon_spec(load_bench(str(path))))


def at_the_ports(robot, path):
    """What comes near to the propellers' port, in words after `hil`."""
    yield ("discover",)
    yield ("discover", "--port", robot.endpoints["thrust"]["port"], STANDS)
    yield ("doctor", "--bench", str(path), "--watch", "0.3")


def all_others(robot, path):
    """Whatever else only asks; no words stand for the completion of a shell."""
    ends, bench = robot.endpoints, ("--bench", str(path))
    can = ("--can", f"{ends['can']['interface']}:{ends['can']['channel']}:{ends['can']['port']}")
    ports = [word for name in ("servos", "imu", "thrust") for word in ("--port", ends[name]["port"])]
    servo = ("--baud", str(ends["servos"]["baud"]), "--id", "5", "--new-id", "9", "--dry-run")
    yield ("discover", *ports, *can)
    yield ("discover", *ports, *can, STANDS)
    yield ("accept", *bench)
    yield ("setup", "--port", ends["servos"]["port"], *servo)
    yield ("setup", "--port", ends["thrust"]["port"], *servo)
    yield ("adhesion", "status", *bench)
    yield ("info", "--json")
    yield ("list",)
    yield ()


ENDS = {"discover": 4, "accept": 4, "adhesion": 0, "info": 0, "list": 0}
"""Exit codes without an operator, and without an option for where the robot stands."""
BOTH = pytest.mark.parametrize("commands", [at_the_ports, all_others])


@contextmanager
def asking(words, path):
    """A command of `hil` at work, beside its bench file and without a terminal; without words, completion."""
    completing = {"_HIL_COMPLETE": "bash_complete", "COMP_WORDS": "hil doctor --bench ", "COMP_CWORD": "3"}
    with subprocess.Popen(
        [sys.executable, "-m", "hil", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=path.parent,
        env={**ENVIRONMENT, **({} if words else completing), "XDG_STATE_HOME": os.environ["XDG_STATE_HOME"]},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def watched(robot, process):
    """The truth again and again while a command is at work, and for a second after it."""
    end_s = time.monotonic() + LONGEST_S
    yield robot.truth()
    while process.poll() is None:
        assert time.monotonic() < end_s
        time.sleep(0.02)
        yield robot.truth()
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        time.sleep(0.02)
        yield robot.truth()


def assert_as_before(before, seen):
    """Thrust and force stay, all servos hold."""
    assert not any(truth["fallen"] for truth in seen)
    assert all(all(truth["torque"]) for truth in seen)
    for force in ("thrust_n", "adhesion_n"):
        assert min(truth[force] for truth in seen) >= LEAST_SHARE * before[force] > 1.0


@BOTH
def test_nothing_that_asks_changes_what_holds_a_hanging_robot(robot, commands):
    robot, path = robot
    wait_until(lambda: robot.truth()["wheels_rad_s"] < TURNS_RAD_S, "wheels at rest")
    before = robot.truth()
    for words in commands(robot, path):
        with asking(words, path) as process:
            seen, said = list(watched(robot, process)), process.stderr.read()
        assert_as_before(before, seen)
        assert max(truth["wheels_rad_s"] for truth in seen[1:]) < TURNS_RAD_S, words
        assert max(dist(truth["pose"][:2], before["pose"][:2]) for truth in seen) < MOST_M, words
        assert "Traceback" not in said, said
        if words and STANDS not in words:
            assert process.returncode == ENDS.get(words[0], process.returncode), said
        if STANDS in words:
            assert f"not asked: {robot.endpoints['thrust']['port']}: " in said


@BOTH
def test_nothing_that_asks_changes_what_holds_a_robot_that_drives(robot, commands):
    robot, path = robot
    with bench_driving(path, "patient") as bench:
        wait_until(lambda: all(robot.truth()["turning"]), "a driving robot")
        before = robot.truth()
        for words in commands(robot, path):
            with asking(words, path) as process:
                assert_as_before(before, list(watched(robot, process)))
        assert bench.poll() is None
        log = path.with_name("bench.log").read_text()
    assert "stopped" not in log, log
