"""What becomes of a robot on its wall when a process or its computer fails, by its chips' own registers.

The robot is emulated in a process of its own; a bench drives it in real time and meets with what processes
meet with. A busy computer may end a drive: the robot has to be held all the same. Something else presses it
on its wall: what becomes of the fan is seen in `test_wall_killed.py` and `test_daemon_killed.py`.
"""

import json
import os
import pty
import resource
import select
import signal
import subprocess
import sys
import time
from math import dist
from pathlib import Path

import pytest
from wall_trials import ENVIRONMENT, bench_driving, robot_on_the_wall

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]
RESTS_S, LONGEST_S = 0.5, 180.0
JERK_RAD_S, JERK_M = 0.5, 0.005


@pytest.fixture
def robot(tmp_path):
    """(the emulated robot on its wall, a bench file in which it is real)."""
    with robot_on_the_wall(seed=1, fan=False) as robot:
        yield robot, robot.bench_file(tmp_path)


def under_way(robot):
    """The truth while wheels turn."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        truth = robot.truth()
        if all(truth["turning"]):
            return truth
        time.sleep(0.02)
    raise AssertionError(f"no wheel turns within {LONGEST_S:g} s")


def assert_held(robot, before, *, since_s=RESTS_S):
    """All eight have torque and no wheel is asked to turn; where it is then."""
    time.sleep(since_s)
    truth = robot.truth()
    assert truth["torque"] == [True] * 8
    assert truth["turning"] == [False] * 4
    assert not truth["fallen"]
    robot.truth()
    time.sleep(0.5)
    later = robot.truth()
    assert later["wheels_rad_s"] < 0.05
    assert dist(later["pose"][:2], truth["pose"][:2]) < 5e-4
    assert dist(later["pose"][:2], before["pose"][:2]) < 0.05
    return later


def assert_taken_over_without_a_jerk(robot, path, held):
    """Another bench opens, switches torque on where it is missing, and looks at the robot."""
    robot.truth()
    with bench_driving(path, "patient"):
        taken = robot.truth()
    assert taken["wheels_rad_s"] < JERK_RAD_S
    assert taken["steering_rad_s"] < JERK_RAD_S
    assert dist(taken["pose"][:2], held["pose"][:2]) < JERK_M


def test_a_bench_that_is_killed_leaves_it_held_and_the_next_takes_it_over(robot):
    robot, path = robot
    with bench_driving(path, "patient") as process:
        before = under_way(robot)
        process.kill()
        held = assert_held(robot, before)
    assert_taken_over_without_a_jerk(robot, path, held)


def test_a_bench_without_memory_leaves_it_held(robot):
    robot, path = robot
    with bench_driving(path, "patient") as process:
        before = under_way(robot)
        pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[0])
        used = pages * resource.getpagesize()
        resource.prlimit(process.pid, resource.RLIMIT_AS, (used, used))
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (1 << 20, 1 << 20))
        time.sleep(3.0)
        assert not robot.truth()["fallen"]
        process.kill()
        assert_held(robot, before)


def test_busy_cores_do_not_drop_the_robot(robot):
    robot, path = robot
    burn = [sys.executable, "-c", "while True: pass"]
    with bench_driving(path, "patient") as process:
        under_way(robot)
        burning = [subprocess.Popen(burn) for _ in range(2 * os.cpu_count())]
        try:
            time.sleep(3.0)
        finally:
            for one in burning:
                one.kill()
                one.wait()
        before = robot.truth()
        assert not before["fallen"]
        process.kill()
        assert_held(robot, before)


def test_the_time_of_day_may_leap(robot):
    robot, path = robot
    with bench_driving(path, "patient") as process:
        before = under_way(robot)
        os.kill(process.pid, signal.SIGUSR1)
        time.sleep(2.0)
        assert process.poll() is None
        after = under_way(robot)
        assert not after["fallen"]
        process.kill()
        assert_held(robot, before, since_s=RESTS_S)


def test_a_terminal_that_is_closed_ends_a_session_with_the_robot_held(robot, tmp_path):
    robot, path = robot
    run = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "hil.cli", "live", "--bench", str(path), "--record", str(run)]
    child, terminal = pty.fork()
    if not child:
        os.execve(sys.executable, command, ENVIRONMENT)
    end_s, said = time.monotonic() + LONGEST_S, b""
    while not (run.exists() and run.stat().st_size > 50_000):
        assert time.monotonic() < end_s, said
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                said += os.read(terminal, 4096)
            except OSError:  # it has ended
                pytest.fail(said.decode())
    before = robot.truth()
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 4
    assert_held(robot, before)


def test_a_robot_that_is_gone_is_said_to_be_not_held(tmp_path):
    with robot_on_the_wall(seed=1, fan=False) as robot:
        path = robot.bench_file(tmp_path)
        command = [sys.executable, "-m", "hil.cli", "live", "--bench", str(path), "--no-record", "--json"]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
        ) as process:
            while "at the start HELD" not in process.stderr.readline():
                assert process.poll() is None
            time.sleep(0.5)
            robot.kill()
            out, err = process.communicate(timeout=120)
    assert process.returncode in (3, 4), err
    assert json.loads(out)["held"]["state"] == "NOT HELD"
