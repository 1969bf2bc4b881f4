"""Bench and daemon killed at random moments of wall runs in real time: the robot stays where it is."""

import pytest
from kills import end_daemon
from wall_trials import HALF_BLIND, benches_killed, daemons_killed, poses_per_s, robot_on_the_wall

from hil.bench.fan_commands import daemon_spec
from hil.config.loading import load_bench

pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]
MOST_S = 0.2


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """(the emulated robot on its wall, a bench file in which it is real)."""
    folder = tmp_path_factory.mktemp("wall")
    with pytest.MonkeyPatch.context() as patch, robot_on_the_wall(seed=1) as robot:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        path = robot.bench_file(folder)
        yield robot, path
        end_daemon(daemon_spec(load_bench(str(path))))


def test_benches_that_are_killed_while_they_drive_leave_a_held_robot(robot):
    found = benches_killed(*robot, 20, seed=1)
    assert max(kill.gap_s for kill in found) <= MOST_S
    assert all(kill.held for kill in found)


def test_of_benches_that_are_killed_with_a_fault_no_fault_is_left(robot):
    found = benches_killed(*robot, 5, seed=3, faults=(HALF_BLIND,))
    assert max(kill.gap_s for kill in found) <= MOST_S
    assert all(kill.held for kill in found)
    assert poses_per_s(robot[1]) > 150.0  # with the fault left it were 100


def test_daemons_that_are_killed_under_a_driving_bench_do_not_drop_the_robot(robot):
    found = daemons_killed(*robot, 20, seed=2)
    assert max(kill.gap_s for kill in found) <= MOST_S
    assert all(kill.held for kill in found)
