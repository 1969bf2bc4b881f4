"""Programs that are stopped for seconds while a robot drives on its wall, and then go on (SIGSTOP, SIGCONT).

Robot, daemon and bench are processes of their own, in real time.
"""

import os
import re
import signal
import time
from math import dist

import pytest
from kills import both, end_daemon, wait_until
from wall_trials import bench_driving, robot_on_the_wall

from hil.bench.fan_commands import daemon_spec
from hil.config.loading import load_bench

pytestmark = pytest.mark.timeout(120)
STOPPED_S = 1.5
LEAST_SHARE, MOST_M, DRIVES_M = 0.9, 1e-3, 0.01


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """(the emulated robot, the bench that drives it, the fan's daemon, what the bench says)."""
    folder = tmp_path_factory.mktemp("stopped")
    with pytest.MonkeyPatch.context() as patch, robot_on_the_wall(seed=1) as robot:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        path = robot.bench_file(folder)
        spec = daemon_spec(load_bench(str(path)))
        try:
            with bench_driving(path, "patient") as process:
                yield robot, process, spec, folder / "bench.log"
        finally:
            end_daemon(spec)


def turning(robot):
    """The truth about a robot that drives."""
    return wait_until(lambda: (truth := robot.truth()) and all(truth["turning"]) and truth, "a driving robot")


def goes_on(robot, before):
    """It hangs as before and drives again."""
    here = robot.truth()["pose"]
    wait_until(lambda: dist(robot.truth()["pose"][:2], here[:2]) > DRIVES_M, "a robot that drives again")
    after = robot.truth()
    assert not after["fallen"]
    assert all(after["torque"])
    for force in ("adhesion_n", "thrust_n"):
        assert after[force] > LEAST_SHARE * before[force]


def test_a_bench_that_stood_still_left_a_held_robot_and_blames_itself(driven):
    robot, process, _, log = driven
    before = turning(robot)
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(0.5 * STOPPED_S)
    first = robot.truth()
    time.sleep(0.5 * STOPPED_S)
    second = robot.truth()
    os.kill(process.pid, signal.SIGCONT)
    assert not any(first["turning"] + second["turning"])
    assert dist(first["pose"][:2], second["pose"][:2]) < MOST_M
    assert all(second["torque"])
    goes_on(robot, before)
    said = log.read_text()
    assert "robot stopped (held_up)" in said
    assert "check its bus" not in said


def test_a_daemon_that_stands_still_costs_no_force(driven):
    robot, _, spec, log = driven
    before = turning(robot)
    _, daemon = wait_until(lambda: both(spec), "a standby")
    os.kill(daemon, signal.SIGSTOP)
    least = before["adhesion_n"]
    end_s = time.monotonic() + STOPPED_S
    while time.monotonic() < end_s:
        least = min(least, robot.truth()["adhesion_n"])
        time.sleep(0.1)
    os.kill(daemon, signal.SIGCONT)
    assert least > LEAST_SHARE * before["adhesion_n"]
    goes_on(robot, before)
    assert "daemon does not answer" in log.read_text()


@pytest.mark.long
def test_devices_that_fall_silent_and_come_back_stop_the_robot_by_name(driven):
    robot, _, _, log = driven
    before, known = turning(robot), len(log.read_text())
    os.kill(robot.pid, signal.SIGSTOP)
    time.sleep(STOPPED_S)
    try:
        wait_until(lambda: re.search(r"robot stopped \(|: no ", log.read_text()[known:]), "a word of it")
    finally:
        os.kill(robot.pid, signal.SIGCONT)
    goes_on(robot, before)
